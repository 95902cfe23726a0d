"""``skin tare`` and ``skin calibration`` with a gateway and of files, and their errors."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from calibration.command import calibration, tare
from canskin.calibration_messages import (
    CALIBRATION,
    ZERO,
    CalibrationReply,
    CalibrationRequest,
    CalibrationState,
    CalibrationStatus,
    ZeroRequest,
)
from canskin.description import LAYOUT as LAYOUT_QUESTION
from canskin.errors import BusError, InputError, RunError
from canskin.fabric import Fabric, Reply
from canskin.question import Question
from shell.skin_options import SkinOptions, join
from skin.calibration_file import StoredCalibration, encoded, load_calibration, new_calibration, parse_calibration
from skin.defects import SumGains
from tests.calibration.helpers import LAYOUT, PHI
from tests.processes import Verb

SUMS, TAXELS = PHI.shape
STATUS = CalibrationStatus(
    state=CalibrationState.FOLLOWING, drift_rms_n_per_s=0.0123, noise_n=0.00456, held_blocks=7, doubtful_taxels=3
)


def of_all() -> StoredCalibration:
    """Return a calibration with two offsets and all kinds of gains."""
    offsets_n = np.full(SUMS, np.nan)
    offsets_n[[3, 5]] = 0.07, -0.01
    gains = np.linspace(0.9, 1.1, TAXELS)
    of_sums = SumGains(np.linspace(0.95, 1.05, SUMS), np.linspace(-0.02, 0.03, SUMS))
    return new_calibration(
        LAYOUT, offsets_n=offsets_n, gains=gains, sum_gains=of_sums, defects=["sum 3 is stuck", "taxel 7"]
    )


class Gateway:
    """A gateway that answers what it is told to."""

    def __init__(self, endpoint: str) -> None:
        self.requests: list[Any] = []
        self.is_done, self.stored = True, of_all()
        self.status: CalibrationStatus | None = STATUS
        self.of = SkinOptions(connect=endpoint)
        self.fabric = join(LAYOUT, "gateway", endpoint, hub=True)
        for question in (CALIBRATION, ZERO):
            self.fabric.answer(question, self._answer)

    def _answer(self, request: CalibrationRequest | ZeroRequest, reply: Reply) -> None:
        self.requests.append(request)
        content = encoded(self.stored)
        reply(CalibrationReply(is_done=self.is_done, text="words", status=self.status, content=content))


@pytest.fixture
def gateway(endpoint: str) -> Iterator[Gateway]:
    made = Gateway(endpoint)
    yield made
    made.fabric.close()


def shown(capsys: pytest.CaptureFixture[str]) -> list[tuple[str, str]]:
    """Return the printed table: each line is a name and a value, two blanks or more apart."""
    lines = [line.strip().split("  ", 1) for line in capsys.readouterr().out.splitlines()]
    return [(name, value.strip()) for name, value in lines]


def test_tare_tells_what_was_found(gateway: Gateway, capsys: pytest.CaptureFixture[str]) -> None:
    assert tare(of=gateway.of) == 0
    gateway.is_done = False
    assert tare(of=gateway.of, force=True, json=True) == 1
    text, document = capsys.readouterr().out.split("\n", 1)
    tare(of=gateway.of, region="0,1,62,63")
    assert text == "words"
    assert json.loads(document)["status"]["state"] == "following"
    assert [each.force for each in gateway.requests] == [False, True, False]
    assert [each.region for each in gateway.requests] == [None, None, (0, 1, 62, 63)]


IN_FILE = [
    ("skin", f"{LAYOUT.name}, Φ {PHI.fingerprint}"),
    ("sums with an offset", "2 of 1024"),
    ("offsets", "50.00 mN rms, -10.00 to 70.00 mN"),  # √((70² + 10²) / 2) = 50
    ("gains of taxels", "0.900 to 1.100"),
    ("gains of sums", "differential 0.950 to 1.050, common mode -0.020 to 0.030"),
    ("defect", "sum 3 is stuck"),
    ("defect", "taxel 7"),
]
OF_GATEWAY = [
    ("zero", "following"),
    ("drift", "12.300 mN/s rms"),
    ("noise of a sum", "4.56 mN"),
    ("blocks under a touch", "7"),
    ("doubtful taxels", "3, with 0 N"),
]


def test_the_calibration_of_a_gateway_is_shown_saved_and_loaded(
    gateway: Gateway, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    waits_s, ask = list[tuple[str, float]](), Fabric.ask

    def noted(fabric: Fabric, question: Question, request: object, timeout_s: float) -> object:
        waits_s.append((question.name, timeout_s))
        return ask(fabric, question, request, timeout_s)

    monkeypatch.setattr(Fabric, "ask", noted)
    calibration("show", of=gateway.of)
    assert sorted(each for each in shown(capsys) if each[0] != "saved") == sorted(IN_FILE + OF_GATEWAY)
    path = tmp_path / "it.json"
    calibration("save", path, of=gateway.of)
    words = "offsets of 2 of 1024 sums, gains of 4096 taxels, gains of 1024 sums"
    assert capsys.readouterr().err == f"calibration: {path}: {words}\n"
    assert path.read_bytes() == encoded(gateway.stored)
    calibration("show", path, of=gateway.of)
    assert sorted(each for each in shown(capsys) if each[0] != "saved") == sorted(IN_FILE)
    calibration("load", path, of=gateway.of)
    assert capsys.readouterr().err == "calibration: words\n"
    calibration("load", path, of=gateway.of, to_nodes=True)
    assert [getattr(each, "action", None) for each in gateway.requests] == [None, None, "load", "write"]
    assert [each for each in waits_s if each[0] != LAYOUT_QUESTION.name] == [
        *[(ZERO.name, 15), (ZERO.name, 15), (CALIBRATION.name, 15), (CALIBRATION.name, 300)]
    ]
    assert parse_calibration(gateway.requests[-1].content, LAYOUT, "test") == load_calibration(path, LAYOUT)


def test_a_gateway_that_refuses_or_has_nothing_fails_the_verb(gateway: Gateway, tmp_path: Path) -> None:
    path = tmp_path / "it.json"
    path.write_bytes(encoded(of_all()))
    gateway.is_done, gateway.stored = False, new_calibration(LAYOUT)
    for to_nodes in (False, True):
        with pytest.raises(RunError, match="words"):
            calibration("load", path, of=gateway.of, to_nodes=to_nodes)
    off = CalibrationStatus(state=CalibrationState.OFF)
    for status, why in (
        (STATUS, "yet: is the skin untouched"),
        (None, "yet"),
        (off, "and measures none: start it with"),
    ):
        gateway.status = status
        with pytest.raises(RunError, match=f"no calibration {why}"):
            calibration("save", tmp_path / "other.json", of=gateway.of)
    assert not (tmp_path / "other.json").exists()


def test_offsets_that_no_sum_can_have_are_shown_saved_and_named_but_not_loaded(
    gateway: Gateway, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    offsets_n = np.full(SUMS, np.nan)
    offsets_n[[2, 7, 9]] = 0.64, 0.65, -7.0
    gateway.stored, path = new_calibration(LAYOUT, offsets_n=offsets_n), tmp_path / "it.json"
    named = "2 offsets beyond ±640 mN, first of sum 7: no gateway loads them"
    calibration("show", of=gateway.of)
    assert ("out of range", named) in shown(capsys)
    calibration("save", path, of=gateway.of)
    assert capsys.readouterr().err == f"calibration: {path}: offsets of 3 of 1024 sums: {named}\n"
    with pytest.raises(InputError, match=r"it.json: 2 offsets_n that this skin cannot have: expected -0.64 to 0.64"):
        calibration("load", path, of=gateway.of)


def test_json_holds_calibration_and_status(
    gateway: Gateway, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    calibration("show", json=True, of=gateway.of)
    document = json.loads(capsys.readouterr().out)
    assert document["calibration"] == msgspec.to_builtins(gateway.stored)
    assert document["status"]["held_blocks"] == 7
    (tmp_path / "it.json").write_bytes(encoded(of_all()))
    calibration("show", tmp_path / "it.json", json=True, of=gateway.of)
    assert json.loads(capsys.readouterr().out)["status"] is None


def test_a_table_of_gains_becomes_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    np.savetxt(tmp_path / "gains.csv", np.full((64, 64), 1.25), delimiter=",")
    calibration("gain", tmp_path / "gains.csv", out=tmp_path / "it.json")
    assert capsys.readouterr().err == f"calibration: {tmp_path / 'it.json'}: gains of 4096 taxels\n"
    for option in ({"force_n": 1.0}, {"before": tmp_path / "it.json"}):
        with pytest.raises(InputError, match=r"a \.csv holds the gains themselves"):
            calibration("gain", tmp_path / "gains.csv", out=tmp_path / "it.json", **option)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="expected a file: skin calibration gain FILE"):
        calibration("gain", out=tmp_path / "it.json")


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
            ["calibration", "gain", "run.log", "--out", "gains.json"],
            "run.log: expected a recording (.mcap)",
        ),
        (
            ["calibration", "gain", "run.mcap", "--layout=default", "--out", "gains.json"],
            "expected the force of the weight",
        ),
        (
            ["calibration", "gain", "none.csv", "--out", "gains.json"],
            "none.csv: cannot read a table of gains",
        ),
    ],
)
def test_wrong_input_is_one_line_and_exit_code_2(arguments: list[str], said: str, skin: Verb) -> None:
    code, _, told = skin(*arguments)
    assert code == 2
    assert said in told
    assert len(told.splitlines()) == 1
