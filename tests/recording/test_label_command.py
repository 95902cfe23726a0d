"""``skin label`` as a user calls it."""

import json
from pathlib import Path

import numpy as np
import pytest

from canskin.errors import InputError, RunError
from canskin.messages import MARK
from classifier import touches
from dbc.contract import Contract
from recording.label_command import label
from recording.recorded_tables import read_tables
from recording.run_steps import steps_of
from recording.step_kinds import MessageStep
from skin.layout import Layout
from tests.layouts import small_layout
from tests.recordings import HOLD, REST, write_touches

SLOW: Layout = small_layout(16, 16, sync={"rate_hz": 20.0})


@pytest.fixture
def touched(tmp_path: Path) -> Path:
    force_n = np.full((3, 16, 16), 0.001, np.float32)
    return write_touches(tmp_path / "run.mcap", SLOW, force_n, ["cup", "", ""])


def listed(capsys: pytest.CaptureFixture[str], path: Path, *labels: str) -> list[dict[str, object]]:
    label(path, *labels, json=True)
    found: list[dict[str, object]] = json.loads(capsys.readouterr().out)
    return found


def test_touches_are_listed(touched: Path, capsys: pytest.CaptureFixture[str]) -> None:
    label(touched)
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split() == ["touch", "begins,", "s", "lasts,", "s", "taxels", "force,", "N", "contacts", "label"]
    assert lines[1].split() == ["1", "0.80", "0.25", "256", "0.256", "1", "cup"]
    first, second, _ = listed(capsys, touched)
    assert (first["label"], second["label"], first["cycles"]) == ("cup", "", HOLD)
    assert second["begin_s"] == pytest.approx(0.05 * (2 * REST + HOLD))


def test_labels_are_set_and_removed_by_number_and_by_time(touched: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def names(*labels: str) -> list[object]:
        return [each["label"] for each in listed(capsys, touched, *labels)]

    assert names("2-3=ball") == ["cup", "ball", "ball"]
    assert names("1=", "3=a pen") == ["", "ball", "a pen"]
    assert names("0:1.5=can") == ["can", "ball", "a pen"]
    assert names() == ["can", "ball", "a pen"]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("cup", "expected NUMBER=LABEL"),
        ("first=cup", "expected NUMBER=LABEL"),
        ("0=cup", "touches from 1 to 3"),
        ("2-4=cup", "touches from 1 to 3"),
        ("3-2=cup", "the first before the last"),
        ("3:2=cup", "ends after its begin"),
        ("900:999=cup", "expected a time of the recording"),
        ("1=unknown object", "expected printable text"),
        ("1=a\tb", "expected printable text"),
        ("1= cup", "without spaces at its ends"),
        (f"1={'x' * 61}", "up to 60 characters"),
    ],
)
def test_what_sets_no_label_is_refused_and_nothing_is_written(touched: Path, text: str, says: str) -> None:
    with pytest.raises(InputError, match=says):
        label(touched, "1=cup", text)
    assert not touches.labels_path(touched).exists()


def test_what_is_no_recording_and_a_full_disk_are_told(
    touched: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(InputError, match="expected a recording"):
        label(tmp_path / "run.log")

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(touches, "write_file", full)
    with pytest.raises(RunError, match=r"run\.labels\.json: the labels cannot be written: No space"):
        label(touched, "1=cup")


def test_an_export_has_the_touches_with_their_labels(touched: Path) -> None:
    label(touched, "3=ball")
    table = read_tables(touched, SLOW, pytest.fail).named()["touches"]
    assert table["label"].tolist() == ["cup", "", "ball"]
    assert table["number"].tolist() == [1, 2, 3]
    assert (table["end_ns"] - table["begin_ns"]).tolist() == [50_000_000 * (HOLD - 1)] * 3


def test_a_replay_keeps_the_marks(touched: Path) -> None:
    steps = steps_of(touched, Contract.from_layout(SLOW))
    marks = [each.message for each in steps if isinstance(each, MessageStep) and each.topic is MARK]
    assert [each.label for each in marks] == ["cup", "", ""]
