"""The zero that outlives a run: ``skin gateway --keep-zero``."""

from collections.abc import Callable
from pathlib import Path

import msgspec
import numpy as np
import pytest

from calibration.keeping import kept_zero
from canskin.calibration_messages import CalibrationRequest
from dbc.contract import Contract
from gateway.calibration import GatewayCalibration
from skin.calibration_file import encoded, load_calibration, new_calibration

SUMS = 32


def load(calibration: GatewayCalibration, contract: Contract, offset_n: float, now_s: float) -> None:
    """Have the gateway take another zero."""
    content = encoded(new_calibration(contract.layout, offsets_n=np.full(SUMS, offset_n)))
    calibration.ask(CalibrationRequest(action="load", content=content), lambda _: None)
    calibration.tick({}, now_s)


def test_the_zero_is_kept_once_a_minute_and_at_the_end_in_another_thread(small: Contract, tmp_path: Path) -> None:
    path, aside = tmp_path / "zero.json", list[Callable[[], None]]()

    def kept() -> list[float | None]:
        for each in aside:
            each()
        aside.clear()
        return load_calibration(path, small.layout).offsets_n[:1] if path.exists() else []

    calibration = GatewayCalibration(small, tares=False, submit=aside.append, keeps=path)
    calibration.tick({}, 0.0)
    calibration.keep_zero()
    assert (aside, kept()) == ([], [])  # there is no zero
    load(calibration, small, 0.01, 1.0)
    calibration.tick({}, 1.1)
    assert not path.exists()  # not in this thread
    assert kept() == [0.01]
    load(calibration, small, 0.02, 2.0)
    calibration.tick({}, 61.0)
    assert kept() == [0.01]
    calibration.tick({}, 61.2)
    assert kept() == [0.02]
    calibration.tick({}, 200.0)
    assert aside == []  # it is the same zero
    load(calibration, small, 0.03, 200.5)
    calibration.keep_zero()
    assert kept() == [0.03]


def test_without_a_file_nothing_is_kept(small: Contract) -> None:
    aside: list[Callable[[], None]] = []
    calibration = GatewayCalibration(
        small, new_calibration(small.layout, offsets_n=np.zeros(SUMS)), tares=False, submit=aside.append
    )
    calibration.tick({}, 0.0)
    calibration.keep_zero()
    assert aside == []


def test_a_new_run_begins_with_the_zero_of_the_run_before_and_does_not_date_it_anew(
    small: Contract, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "zero.json"
    assert kept_zero(path, small.layout, None) is None
    assert capsys.readouterr().err == ""  # as before the first run
    offsets_n = np.linspace(-0.1, 0.1, SUMS)
    path.write_bytes(
        encoded(msgspec.structs.replace(new_calibration(small.layout, offsets_n=offsets_n), saved="some day"))
    )
    named = new_calibration(small.layout, gains=np.full(128, 1.25), offsets_n=np.zeros(SUMS))
    stored = kept_zero(path, small.layout, named)
    assert capsys.readouterr().err == f"gateway: begins with the zero of some day, from {path}\n"
    assert stored is not None
    assert stored.gains == [1.25] * 128
    calibration = GatewayCalibration(small, stored, tares=False, keeps=path)
    assert calibration.status().offset_rms_n == pytest.approx(np.std(offsets_n))
    calibration.tick({}, 0.0)
    calibration.keep_zero()
    assert load_calibration(path, small.layout).saved == "some day"


@pytest.mark.parametrize("content", [b"", b"{}", b"\xff" * 100])
def test_a_damaged_file_is_one_line_and_the_gateway_starts(
    small: Contract, tmp_path: Path, content: bytes, capsys: pytest.CaptureFixture[str]
) -> None:
    path, named = tmp_path / "zero.json", new_calibration(small.layout, offsets_n=np.zeros(SUMS))
    path.write_bytes(content)
    assert kept_zero(path, small.layout, named) is named
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"gateway: starts without the zero of an earlier run: {path}: expected a file of")


def test_a_zero_of_another_skin_or_a_folder_is_one_line(
    small: Contract, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "zero.json"
    path.write_bytes(encoded(msgspec.structs.replace(new_calibration(small.layout), fingerprint="0" * 16)))
    for place, said in ((path, "the calibration of another layout"), (tmp_path, "cannot read the calibration")):
        assert kept_zero(place, small.layout, None) is None
        (line,) = capsys.readouterr().err.splitlines()
        assert said in line
    path.write_bytes(encoded(new_calibration(small.layout)))
    assert kept_zero(path, small.layout, None) is None
    assert "has no offsets of sums" in capsys.readouterr().err


def test_a_place_that_cannot_be_written_is_said_once_until_it_can(
    small: Contract, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "none" / "zero.json"
    calibration = GatewayCalibration(small, tares=False, keeps=path)

    def lines(offset_n: float) -> list[str]:
        load(calibration, small, offset_n, 0.0)
        calibration.keep_zero()
        return capsys.readouterr().err.splitlines()

    assert lines(0.01) == [f"gateway: {path}: cannot keep the zero there: No such file or directory"]
    assert lines(0.02) == []
    path.parent.mkdir()
    assert lines(0.03) == []
    assert load_calibration(path, small.layout).offsets_n == [0.03] * SUMS
    path.unlink()
    path.parent.rmdir()
    assert len(lines(0.04)) == 1


def test_offsets_that_no_sum_can_have_are_not_kept(small: Contract, tmp_path: Path) -> None:
    path = tmp_path / "zero.json"
    offsets_n = np.full(SUMS, 0.01)
    offsets_n[3] = 1e6
    calibration = GatewayCalibration(small, new_calibration(small.layout, offsets_n=offsets_n), tares=False, keeps=path)
    calibration.keep_zero()
    assert load_calibration(path, small.layout).offsets_n == [0.01] * 3 + [None] + [0.01] * 28
