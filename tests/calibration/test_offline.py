"""Runs that were recorded without calibration."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from calibration.calibrator import Calibrator
from calibration.offline import calibrated, make_calibrator, measurement_of
from canskin.errors import InputError
from canskin.messages import MEASUREMENT
from recording.mcap_file import CALIBRATION_FILE, File, RecordingWriter
from skin.calibration_file import encoded, load_calibration, new_calibration
from skin.measured_sums import decode_measurement
from tests.calibration.helpers import LAYOUT, NEWTON_PER_COUNT, PHI, offsets_n, pressed
from tests.layouts import STEPPED_SKIN

OFFSETS = PHI.forward(offsets_n())


def calibrated_counts(counts: np.ndarray, valid: np.ndarray, period_ns: int) -> np.ndarray:
    """The sums of cycles less the offsets that are measured meanwhile."""
    made = (
        msgspec.structs.replace(
            measurement_of(LAYOUT, PHI, cycle, each, time_ns=(cycle + 1) * period_ns), usable=used.tobytes()
        )
        for cycle, (each, used) in enumerate(zip(counts, valid, strict=True))
    )
    return np.stack([decode_measurement(each, PHI).counts for each in calibrated(made, Calibrator(LAYOUT))])


def test_cycles_lose_their_offsets_when_the_zero_is_measured() -> None:
    noise = np.random.default_rng(0).normal(0, 2e-4, (500, PHI.shape[0]))
    touch_n = np.zeros((500, PHI.shape[0]))
    touch_n[400:] = PHI.forward(pressed(20, 20, 9, 5e-3))
    counts = np.rint((OFFSETS + noise + touch_n) / NEWTON_PER_COUNT).astype(np.int32)
    valid = np.ones(counts.shape, np.bool_)
    valid[460, 5] = False  # a sum that saturates is lost alone
    corrected = calibrated_counts(counts, valid, 25_000_000)
    np.testing.assert_array_equal(corrected[:100], counts[:100])
    error_n = corrected[350:] * NEWTON_PER_COUNT - touch_n[350:]
    error_n[~valid[350:]] = 0
    assert error_n.std() < 3e-4
    assert not corrected[460, 5]


def test_the_zero_is_measured_over_true_times() -> None:
    """At half the SYNC rate of the layout, the zero takes as many seconds and half as many cycles."""
    counts = np.tile(np.rint(OFFSETS / NEWTON_PER_COUNT).astype(np.int32), (100, 1))
    valid = np.ones(counts.shape, np.bool_)
    tared = [not (calibrated_counts(counts, valid, each)[-1] == counts[-1]).all() for each in (25_000_000, 50_000_000)]
    assert tared == [False, True]


def recorded(path: Path, offsets: np.ndarray) -> Path:
    """A recording of a measurement with offsets."""
    writer = RecordingWriter(path, {"wall_offset_ns": "1000"}, [], 1)
    made = measurement_of(LAYOUT, PHI, 0, np.zeros(PHI.shape[0], np.int32), time_ns=5)
    made = msgspec.structs.replace(made, offsets=offsets.astype("<i4").tobytes())
    writer.message(MEASUREMENT, 1, msgspec.msgpack.encode(made))
    writer.close()
    return path


def test_the_attached_calibration_of_a_recording_has_its_newest_offsets(tmp_path: Path) -> None:
    path = recorded(tmp_path / "run.mcap", np.full(PHI.shape[0], 7))
    assert load_calibration(path, LAYOUT).gains == []
    gains = np.full(PHI.shape[1], 1.25)
    for with_offsets in (True, False):
        path = tmp_path / f"attached-{with_offsets}.mcap"
        writer = RecordingWriter(path, {}, [], 1)
        made = measurement_of(LAYOUT, PHI, 0, np.zeros(PHI.shape[0], np.int32))
        if with_offsets:
            made = msgspec.structs.replace(made, offsets=np.full(PHI.shape[0], 7, "<i4").tobytes())
        old = new_calibration(LAYOUT, offsets_n=np.zeros(PHI.shape[0]))
        new = new_calibration(LAYOUT, offsets_n=np.full(PHI.shape[0], 0.5), gains=gains, defects=["sum 3 is stuck"])
        for each in (old, new):
            writer.attach(File(CALIBRATION_FILE, "application/json", encoded(each)), 1)
            writer.message(MEASUREMENT, 1, msgspec.msgpack.encode(made))
        writer.flush()
        if with_offsets:
            writer.close()
        else:  # as after a crash
            writer.abandon()
        found = load_calibration(path, LAYOUT)
        assert (found.gains, found.defects) == (gains.tolist(), ["sum 3 is stuck"])
        expected_n = 7 * NEWTON_PER_COUNT if with_offsets else 0.5
        np.testing.assert_allclose(found.sum_offsets_n(), expected_n)


def test_options_ask_for_nothing_a_file_or_a_tare(tmp_path: Path) -> None:
    path = tmp_path / "it.json"
    path.write_bytes(encoded(new_calibration(LAYOUT, offsets_n=OFFSETS)))
    assert make_calibrator(LAYOUT, None, "never", "test") is None
    assert make_calibrator(LAYOUT, None, "at-start", "test") is not None
    stored = make_calibrator(LAYOUT, path, "never", "test")
    assert stored is not None
    assert stored.offsets_n == pytest.approx(OFFSETS)
    path.write_bytes(encoded(new_calibration(LAYOUT, gains=np.ones(PHI.shape[1]))))
    with pytest.raises(InputError, match=r"it\.json: has no offsets of sums"):
        make_calibrator(LAYOUT, path, "never", "test")
    with pytest.raises(InputError, match="stepped boards"):
        make_calibrator(STEPPED_SKIN, None, "at-start", "test")
