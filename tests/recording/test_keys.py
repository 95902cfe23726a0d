"""One key: recording, cycle and time_ns are the same in every table, array, bag and view of a run."""

import hashlib
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet
import pytest

from dbc.contract import Contract
from reconstructor.imaging import make_imager
from recording.export_command import export
from recording.mcap_file import RECORDING, read_about, recording_id
from recording.replay_command import replay
from recording.replaying import Agreement, Replay
from recording.run_steps import steps_of
from recording.sinks import McapSink
from shell.service import StopSignal
from skin.wall_times import recorded_wall_times
from tests.documents import block
from tests.recording.helpers import COUNT, OFFSET_NS, SET_NS

TIMES_NS = [OFFSET_NS + 10 * cycle + SET_NS * (cycle > 2) for cycle in range(1, COUNT + 1)]
KEY = ["recording", "cycle", "time_ns"]


def test_the_document_joins_the_tables(
    run: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(run.parent)
    export(run, to="parquet")
    exec(block("docs/recording.md", "pandas"), {})  # noqa: S102
    assert capsys.readouterr().out.split()[:3] == ["label", "cup", "0.25"]
    assert pd.read_csv("named.csv").force_n.tolist() == [0.25]


def test_every_table_has_the_key(run: Path) -> None:
    export(run, to="parquet", out=run.with_suffix(".parquet"))
    for table in ("images", "measurements", "contacts", "labels"):
        rows = pd.read_parquet(run.with_name(f"run-{table}.parquet"))
        assert rows[KEY].duplicated().sum() == 0
        assert set(rows.recording) == {recording_id(run)}
        assert rows.time_ns.tolist() == [TIMES_NS[cycle - 1] for cycle in rows.cycle]
    images = pyarrow.parquet.read_table(run.with_name("run-images.parquet"))
    assert len(images["pixels"][0].as_py()) == 256
    assert b"layout" in images.schema.metadata


def test_a_recording_of_the_same_run_has_the_same_name(run: Path, contract: Contract, tmp_path: Path) -> None:
    assert recording_id(run) == read_about(run).metadata[RECORDING] == "small-19700101T000000.000000Z"
    McapSink(tmp_path / "again.mcap", contract, 0, OFFSET_NS, recording_id(run)).close()
    assert recording_id(tmp_path / "again.mcap") == recording_id(run)
    assert recording_id(Path("monday.log")) == "monday"


def test_replayed_images_have_the_numbers_and_times_of_the_export(run: Path) -> None:
    replay(run, out=(out := run.with_suffix(".npz")))
    with np.load(out) as made:
        assert (made["cycle"].tolist(), made["time_ns"].tolist()) == ([*range(1, COUNT + 1)], TIMES_NS)
        assert str(made["recording"]) == recording_id(run)


def test_views_stamp_as_the_arrays(run: Path) -> None:
    wall = recorded_wall_times(run)
    assert [wall.time_ns(10 * cycle) for cycle in range(1, COUNT + 1)] == TIMES_NS


class Silent:
    def replay(self, *_: object) -> tuple[()]:
        return ()


def test_two_replays_are_equal_files(run: Path, contract: Contract, tmp_path: Path) -> None:
    for name in ("one", "two"):
        sink = McapSink(tmp_path / f"{name}.mcap", contract, 0, OFFSET_NS, recording_id(run))
        replay = Replay(contract.layout, make_imager(contract.layout), lambda _: Silent(), sink=sink)  # type: ignore[arg-type,return-value]
        replay.run(steps_of(run, contract), StopSignal(), float("inf"))
        sink.close()
        assert replay.report.images.made
    one, two = (hashlib.sha256((tmp_path / f"{name}.mcap").read_bytes()) for name in ("one", "two"))
    assert one.digest() == two.digest()


@pytest.mark.parametrize(
    ("differences", "verdict"),
    [
        ([{}, {}], "equal"),
        (
            [{"forces (N)": 2e-3}, {}, {"forces (N)": 4e-3}, *[{}] * 3],
            "different up to number 3: forces (N) by up to 0.004",
        ),
        ([{}, {"forces (N)": 4e-7}, {"label": 0.0}], "different up to number 3: forces (N) by up to 4e-07, label"),
        ([None, None], ""),
    ],
)
def test_the_verdict_says_what_differs(differences: list[dict[str, float] | None], verdict: str) -> None:
    agreement = Agreement()
    for each in differences:
        agreement.add(each)
    assert agreement.made == len(differences)
    assert agreement.verdict().startswith(verdict)
    assert bool(verdict) == bool(agreement.verdict())
