"""What ``skin calibration`` prints of a file, and asks a gateway for, without a gateway."""

import json
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from calibration.command import calibration
from canskin.calibration_messages import (
    CalibrationReply,
    CalibrationRequest,
    CalibrationState,
    CalibrationStatus,
)
from canskin.errors import InputError, RunError
from shell import skin_options
from shell.skin_options import SkinOptions
from skin.calibration_file import StoredCalibration, encoded, new_calibration
from skin.defects import SumGains
from tests.calibration.helpers import LAYOUT, PHI

SUMS, TAXELS = PHI.shape
FAR = SkinOptions(layout=Path("default"), connect="tcp/far:1")


class Gateway:
    """Answers in place of a fabric, and keeps what it was asked."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.asked: list[tuple[str, CalibrationRequest, float]] = []
        self.opened: list[tuple[Any, ...]] = []
        self.closed = 0
        self.stored = new_calibration(LAYOUT)
        self.is_done = True
        self.status: CalibrationStatus | None = CalibrationStatus(
            state=CalibrationState.TOUCHED, drift_rms_n_per_s=0.0123, noise_n=0.00456, held_blocks=7
        )
        gateway = self

        class Fabric:
            instance = "own"

            def peers(self) -> list[Any]:
                return []

            def __init__(self, *given: Any, **named: Any) -> None:
                gateway.opened.append((*given, named))

            def ask(self, question: Any, request: CalibrationRequest, timeout_s: float) -> CalibrationReply:
                gateway.asked.append((question.name, request, timeout_s))
                content = encoded(gateway.stored)
                return CalibrationReply(is_done=gateway.is_done, text="words", status=gateway.status, content=content)

            def close(self) -> None:
                gateway.closed += 1

        monkeypatch.setattr(skin_options, "Fabric", Fabric)


@pytest.fixture
def gateway(monkeypatch: pytest.MonkeyPatch) -> Gateway:
    return Gateway(monkeypatch)


def shown(capsys: pytest.CaptureFixture[str]) -> dict[str, str]:
    """Return the printed table: each line is a name and a value, two blanks or more apart."""
    lines = capsys.readouterr().out.splitlines()
    return {name.strip(): value.strip() for name, value in (line.split("  ", 1) for line in lines)}


def of_all() -> StoredCalibration:
    """Return a calibration with two offsets and all kinds of gains."""
    offsets_n = np.full(SUMS, np.nan)
    offsets_n[[3, 5]] = 0.07, -0.01
    gains = np.linspace(0.9, 1.1, TAXELS)
    of_sums = SumGains(np.linspace(0.95, 1.05, SUMS), np.linspace(-0.02, 0.03, SUMS))
    return new_calibration(
        LAYOUT, offsets_n=offsets_n, gains=gains, sum_gains=of_sums, defects=["sum 3 is stuck", "taxel 7"]
    )


def test_a_file_is_shown_in_millinewtons(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "it.json").write_bytes(encoded(of_all()))
    calibration("show", tmp_path / "it.json")
    text = capsys.readouterr().out
    for name, value in (
        ("skin", f"{LAYOUT.name}, Φ {PHI.fingerprint}"),
        ("sums with an offset", "2 of 1024"),
        # √((70² + 10²) / 2) = 50
        ("offsets", "50.00 mN rms, -10.00 to 70.00 mN"),
        ("gains of taxels", "0.900 to 1.100"),
        ("gains of sums", "differential 0.950 to 1.050, common mode -0.020 to 0.030"),
        ("defect", "sum 3 is stuck"),
        ("defect", "taxel 7"),
    ):
        assert any(line.split() == [*name.split(), *value.split()] for line in text.splitlines()), name
    assert "zero" not in text


def test_a_gateway_tells_of_its_zero_too(gateway: Gateway, capsys: pytest.CaptureFixture[str]) -> None:
    calibration("show", of=FAR)
    text = shown(capsys)
    assert text["zero"] == "touched"
    assert text["drift"] == "12.300 mN/s rms"
    assert text["noise of a sum"] == "4.56 mN"
    assert text["blocks under a touch"] == "7"
    ((name, request, timeout_s),) = gateway.asked
    assert (name, request.action, timeout_s) == ("calibration", "show", 15.0)
    (skin, service, connect, named), looked = gateway.opened
    assert looked[1] == ""  # at the hub's layout
    assert (skin, service, connect) == (LAYOUT.name, "calibration", "tcp/far:1")
    assert (named["fingerprint"], named["patience_s"]) == (PHI.fingerprint, 5.0)
    assert gateway.closed == len(gateway.opened)


def test_offsets_that_no_sum_can_have_are_shown_saved_and_named_but_not_loaded(
    gateway: Gateway, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    offsets_n = np.full(SUMS, np.nan)
    offsets_n[[2, 7, 9]] = 0.64, 0.65, -7.0
    gateway.stored, path = new_calibration(LAYOUT, offsets_n=offsets_n), tmp_path / "it.json"
    named = "2 offsets beyond ±640 mN, first of sum 7: no gateway loads them"
    calibration("show", of=FAR)
    assert shown(capsys)["out of range"] == named
    calibration("save", path, of=FAR)
    assert capsys.readouterr().err == f"calibration: {path}: offsets of 3 of 1024 sums: {named}\n"
    assert path.read_bytes() == encoded(gateway.stored)
    calibration("show", path, of=FAR)
    assert shown(capsys)["out of range"] == named
    with pytest.raises(InputError, match=r"it.json: 2 offsets_n that this skin cannot have: expected -0.64 to 0.64"):
        calibration("load", path, of=FAR)


def test_json_holds_calibration_and_status(
    gateway: Gateway, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    gateway.stored = of_all()
    calibration("show", json=True, of=FAR)
    document = json.loads(capsys.readouterr().out)
    assert document["calibration"] == msgspec.to_builtins(gateway.stored)
    assert document["status"]["held_blocks"] == 7
    (tmp_path / "it.json").write_bytes(encoded(of_all()))
    calibration("show", tmp_path / "it.json", json=True, of=FAR)
    assert json.loads(capsys.readouterr().out)["status"] is None


@pytest.mark.parametrize(
    ("stored", "words"),
    [
        (of_all(), "offsets of 2 of 1024 sums, gains of 4096 taxels, gains of 1024 sums"),
        (new_calibration(LAYOUT, gains=np.ones(TAXELS)), "gains of 4096 taxels"),
        (new_calibration(LAYOUT, offsets_n=np.zeros(SUMS)), "offsets of 1024 of 1024 sums"),
    ],
)
def test_what_is_saved_is_said(
    gateway: Gateway, tmp_path: Path, stored: StoredCalibration, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    gateway.stored = stored
    calibration("save", tmp_path / "it.json", of=FAR)
    assert capsys.readouterr().err == f"calibration: {tmp_path / 'it.json'}: {words}\n"
    assert (tmp_path / "it.json").read_bytes() == encoded(stored)


@pytest.mark.parametrize(("to_nodes", "action", "patience_s"), [(False, "load", 15.0), (True, "write", 300.0)])
def test_writing_to_nodes_may_take_minutes(
    gateway: Gateway,
    tmp_path: Path,
    to_nodes: bool,
    action: str,
    patience_s: float,
    capsys: pytest.CaptureFixture[str],
) -> None:
    stored = of_all()
    (tmp_path / "it.json").write_bytes(encoded(stored))
    calibration("load", tmp_path / "it.json", to_nodes=to_nodes, of=FAR)
    assert capsys.readouterr().err == "calibration: words\n"
    ((_, request, timeout_s),) = gateway.asked
    assert (request.action, timeout_s, request.content) == (action, patience_s, encoded(stored))
    gateway.is_done = False
    with pytest.raises(RunError, match="words"):
        calibration("load", tmp_path / "it.json", to_nodes=to_nodes, of=FAR)


def test_a_table_of_gains_becomes_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    np.savetxt(tmp_path / "gains.csv", np.full((64, 64), 1.25), delimiter=",")
    calibration("gain", tmp_path / "gains.csv", out=tmp_path / "it.json")
    assert capsys.readouterr().err == f"calibration: {tmp_path / 'it.json'}: gains of 4096 taxels\n"
    for option in ({"force_n": 1.0}, {"before": tmp_path / "it.json"}):
        with pytest.raises(InputError, match=r"a \.csv holds the gains themselves"):
            calibration("gain", tmp_path / "gains.csv", out=tmp_path / "it.json", **option)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="expected a file: skin calibration gain FILE"):
        calibration("gain", out=tmp_path / "it.json")
