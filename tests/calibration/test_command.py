"""``skin tare`` and ``skin calibration`` with a gateway, and their errors."""

import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from calibration.command import calibration, tare
from canskin.calibration_messages import (
    CALIBRATION,
    CalibrationReply,
    CalibrationRequest,
    CalibrationState,
    CalibrationStatus,
)
from canskin.errors import BusError, RunError
from canskin.fabric import Reply
from shell.command import main
from shell.skin_options import SkinOptions, join
from skin.calibration_file import encoded, load_calibration, new_calibration, parse_calibration
from tests.calibration.helpers import LAYOUT, PHI

STORED = new_calibration(LAYOUT, offsets_n=np.linspace(0, 0.1, PHI.shape[0]), gains=np.linspace(0.9, 1.1, PHI.shape[1]))


class Gateway:
    """A gateway that answers what it is told to."""

    def __init__(self, endpoint: str) -> None:
        self.requests: list[CalibrationRequest] = []
        self.is_done, self.stored, self.state = True, STORED, CalibrationState.FOLLOWING
        self.fabric = join(LAYOUT, "gateway", endpoint, hub=True)
        self.fabric.answer(CALIBRATION, self._answer)

    def _answer(self, request: CalibrationRequest, reply: Reply) -> None:
        self.requests.append(request)
        status = CalibrationStatus(state=self.state, noise_n=1e-3)
        reply(CalibrationReply(is_done=self.is_done, text="words", status=status, content=encoded(self.stored)))


@pytest.fixture
def gateway(endpoint: str) -> Iterator[Gateway]:
    made = Gateway(endpoint)
    yield made
    made.fabric.close()


def test_tare_tells_what_was_found(gateway: Gateway, endpoint: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert tare(of=SkinOptions(connect=endpoint)) == 0
    gateway.is_done = False
    assert tare(of=SkinOptions(connect=endpoint), force=True, json=True) == 1
    text, document = capsys.readouterr().out.split("\n", 1)
    tare(of=SkinOptions(connect=endpoint), region="0,1,62,63")
    assert text == "words"
    assert json.loads(document)["status"]["state"] == "following"
    assert [each.force for each in gateway.requests] == [False, True, False]
    assert [each.region for each in gateway.requests] == [None, None, (0, 1, 62, 63)]


def test_the_calibration_of_a_gateway_is_shown_saved_and_loaded(
    gateway: Gateway, endpoint: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    calibration("show", of=SkinOptions(connect=endpoint))
    shown = capsys.readouterr().out
    assert "1024 of 1024" in shown
    assert "following" in shown
    assert re.search(r"gains of taxels +0\.900 to 1\.100", shown)
    path = tmp_path / "it.json"
    calibration("save", path, of=SkinOptions(connect=endpoint))
    assert load_calibration(path, LAYOUT).offsets_n == STORED.offsets_n
    calibration("show", path, of=SkinOptions(connect=endpoint))
    calibration("load", path, of=SkinOptions(connect=endpoint))
    calibration("load", path, of=SkinOptions(connect=endpoint), to_nodes=True)
    assert [each.action for each in gateway.requests] == ["show", "show", "load", "write"]
    assert parse_calibration(gateway.requests[-1].content, LAYOUT, "test") == load_calibration(path, LAYOUT)


def test_a_gateway_that_refuses_or_has_nothing_fails_the_verb(gateway: Gateway, endpoint: str, tmp_path: Path) -> None:
    path = tmp_path / "it.json"
    path.write_bytes(encoded(STORED))
    gateway.is_done, gateway.stored = False, new_calibration(LAYOUT)
    with pytest.raises(RunError, match="words"):
        calibration("load", path, of=SkinOptions(connect=endpoint))
    with pytest.raises(RunError, match="no calibration yet"):
        calibration("save", tmp_path / "other.json", of=SkinOptions(connect=endpoint))
    gateway.state = CalibrationState.OFF
    with pytest.raises(RunError, match="measures none: start it with --tare at-start"):
        calibration("save", tmp_path / "other.json", of=SkinOptions(connect=endpoint))
    assert not (tmp_path / "other.json").exists()


@pytest.mark.heavy
def test_a_hub_without_gateway_is_named(endpoint: str) -> None:
    hub = join(LAYOUT, "replay", endpoint, hub=True)
    with pytest.raises(BusError, match="no service of skin 'skin' answers"):
        tare(of=SkinOptions(connect=endpoint))
    hub.close()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (
            ["tare", "--layout=default", "--region", "0,0,64,3"],
            "region 0,0,64,3: expected first row, first column, last row and",
        ),
        (["tare", "--layout=default", "--region", "12"], "rows of 0 to 63 and columns of 0 to 63"),
        (
            ["tare", "--layout=default", "--region", "palm"],
            "no region 'palm': expected 'whole skin'; [[region]] in the layout names more",
        ),
        (
            ["tare", "--layout=default", "--region", "0,0,1,1", "--force"],
            "a tare of a region, and by force: expected one of both",
        ),
        (["calibration", "save"], "expected a file: skin calibration save FILE"),
        (["calibration", "show", "--to-nodes"], "--to-nodes is for 'skin calibration load'"),
        (["calibration", "load", "none.json", "--layout=default"], "none.json: cannot read the calibration"),
        (["calibration", "forget"], '"show"'),
        (["calibration", "show", "--force-n", "1"], "--force-n, --before and --out are for 'skin calibration gain'"),
        (["calibration", "gain", "run.mcap", "--force-n", "1"], "expected a file for the gains: --out FILE"),
        (
            ["calibration", "gain", "run.log", "--out", "/dev/null"],
            "run.log: expected a recording (.mcap)",
        ),
        (
            ["calibration", "gain", "run.mcap", "--layout=default", "--out", "/dev/null"],
            "expected the force of the weight",
        ),
        (
            ["calibration", "gain", "none.csv", "--out", "/dev/null"],
            "none.csv: cannot read a table of gains",
        ),
    ],
)
@pytest.mark.filterwarnings("ignore:Cyclopts application invoked without tokens")
def test_wrong_input_is_one_line_and_exit_code_2(
    arguments: list[str], said: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["skin", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    shown = capsys.readouterr()
    assert ended.value.code == 2
    assert said in shown.err
    assert len(shown.err.splitlines()) == 1
