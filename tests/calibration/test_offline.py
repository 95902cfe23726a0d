"""Runs that were recorded without calibration."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from calibration.calibrator import Calibrator
from calibration.offline import calibrated_cycles, has_offsets, make_calibrator, measurement_of
from calibration.stored import save_calibration, store
from canskin.errors import InputError
from canskin.messages import MEASUREMENT
from skin.layout import load_layout
from skin.mcap_file import RecordingWriter
from tests.calibration.skins import LAYOUT, NEWTON_PER_COUNT, PHI, offsets_n, pressed

OFFSETS = PHI.forward(offsets_n())


def test_cycles_lose_their_offsets_when_the_zero_is_measured() -> None:
    noise = np.random.default_rng(0).normal(0, 2e-4, (500, PHI.shape[0]))
    touch_n = np.zeros((500, PHI.shape[0]))
    touch_n[400:] = PHI.forward(pressed(20, 20, 9, 5e-3))
    counts = np.rint((OFFSETS + noise + touch_n) / NEWTON_PER_COUNT).astype(np.int32)
    valid = np.ones((500, PHI.blocks), np.bool_)
    valid[450, 7] = False
    time_ns = np.arange(1, 501) * 25_000_000
    corrected, whole = calibrated_cycles(LAYOUT, counts, valid, time_ns, Calibrator(LAYOUT))
    assert (whole == valid).all()
    np.testing.assert_array_equal(corrected[:100], counts[:100])
    error_n = corrected[350:] * NEWTON_PER_COUNT - touch_n[350:]
    error_n[100, PHI.block_of_sum == 7] = 0
    assert error_n.std() < 3e-4
    assert not corrected[450, PHI.block_of_sum == 7].any()


def test_the_zero_is_measured_over_true_times() -> None:
    """At half the SYNC rate of the layout, the zero takes as many seconds and half as many cycles."""
    counts = np.tile(np.rint(OFFSETS / NEWTON_PER_COUNT).astype(np.int32), (100, 1))
    valid = np.ones((100, PHI.blocks), np.bool_)
    tared = [
        calibrated_cycles(LAYOUT, counts, valid, np.arange(100) * period_ns, Calibrator(LAYOUT))[0][-1].any()
        for period_ns in (25_000_000, 50_000_000)
    ]
    assert tared == [True, False]


def test_a_recording_tells_whether_it_has_offsets(tmp_path: Path) -> None:
    zero = np.zeros(PHI.shape[0], np.int32)
    writer = RecordingWriter(tmp_path / "run.mcap", {}, [], 1)
    writer.add_message(MEASUREMENT, 1, msgspec.msgpack.encode(measurement_of(LAYOUT, PHI, 0, zero)))
    writer.close()
    assert not has_offsets(tmp_path / "run.mcap")
    made = msgspec.structs.replace(measurement_of(LAYOUT, PHI, 0, zero), offsets=zero.tobytes())
    writer = RecordingWriter(tmp_path / "zero.mcap", {}, [], 1)
    writer.add_message(MEASUREMENT, 1, msgspec.msgpack.encode(made))
    writer.close()
    assert has_offsets(tmp_path / "zero.mcap")


def test_options_ask_for_nothing_a_file_or_a_tare(tmp_path: Path) -> None:
    path = tmp_path / "it.json"
    save_calibration(path, store(LAYOUT, offsets_n=OFFSETS))
    assert make_calibrator(LAYOUT, None, "never", "test") is None
    assert make_calibrator(LAYOUT, None, "at-start", "test") is not None
    stored = make_calibrator(LAYOUT, path, "never", "test")
    assert stored is not None
    assert stored.offsets_n == pytest.approx(OFFSETS)
    save_calibration(path, store(LAYOUT, gains=np.ones(PHI.shape[1])))
    with pytest.raises(InputError, match=r"it\.json: has no offsets of sums"):
        make_calibrator(LAYOUT, path, "never", "test")
    with pytest.raises(InputError, match="adaptive boards"):
        make_calibrator(load_layout(Path("adaptive"), adaptive=True), None, "at-start", "test")
