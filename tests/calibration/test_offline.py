"""Runs that were recorded without calibration."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from calibration.calibrator import Calibrator
from calibration.offline import calibrated_cycles, make_calibrator, measurement_of
from calibration.recorded import RecordedOffsets
from canskin.errors import InputError
from canskin.messages import MEASUREMENT
from recording.mcap_file import CALIBRATION_FILE, File, RecordingWriter
from skin.calibration_file import encoded, load_calibration, new_calibration
from tests.calibration.helpers import LAYOUT, NEWTON_PER_COUNT, PHI, offsets_n, pressed
from tests.layouts import STEPPED_SKIN

OFFSETS = PHI.forward(offsets_n())


def test_cycles_lose_their_offsets_when_the_zero_is_measured() -> None:
    noise = np.random.default_rng(0).normal(0, 2e-4, (500, PHI.shape[0]))
    touch_n = np.zeros((500, PHI.shape[0]))
    touch_n[400:] = PHI.forward(pressed(20, 20, 9, 5e-3))
    counts = np.rint((OFFSETS + noise + touch_n) / NEWTON_PER_COUNT).astype(np.int32)
    valid = np.ones(counts.shape, np.bool_)
    valid[450, PHI.block_of_sum == 7] = False
    valid[460, 5] = False  # a sum that saturates is lost alone
    time_ns = np.arange(1, 501) * 25_000_000
    corrected, whole, used = calibrated_cycles(LAYOUT, counts, valid, time_ns, Calibrator(LAYOUT))
    assert (used == valid).all()
    assert np.argwhere(~whole).tolist() == [[450, 7], [460, PHI.block_of_sum[5]]]
    np.testing.assert_array_equal(corrected[:100], counts[:100])
    error_n = corrected[350:] * NEWTON_PER_COUNT - touch_n[350:]
    error_n[~valid[350:]] = 0
    assert error_n.std() < 3e-4
    assert not corrected[450, PHI.block_of_sum == 7].any()


def test_the_zero_is_measured_over_true_times() -> None:
    """At half the SYNC rate of the layout, the zero takes as many seconds and half as many cycles."""
    counts = np.tile(np.rint(OFFSETS / NEWTON_PER_COUNT).astype(np.int32), (100, 1))
    valid = np.ones(counts.shape, np.bool_)
    tared = [
        calibrated_cycles(LAYOUT, counts, valid, np.arange(100) * period_ns, Calibrator(LAYOUT))[0][-1].any()
        for period_ns in (25_000_000, 50_000_000)
    ]
    assert tared == [True, False]


def recorded(path: Path, cycles: list[tuple[int, np.ndarray | None]]) -> Path:
    """A recording with measurements at given times, with offsets or without."""
    writer = RecordingWriter(path, {"wall_offset_ns": "1000"}, [], 1)
    for cycle, (time_ns, offsets) in enumerate(cycles):
        made = measurement_of(LAYOUT, PHI, cycle, np.zeros(PHI.shape[0], np.int32), time_ns=time_ns)
        if offsets is not None:
            made = msgspec.structs.replace(made, offsets=offsets.astype("<i4").tobytes())
        writer.message(MEASUREMENT, 1, msgspec.msgpack.encode(made))
    writer.close()
    return path


def test_cycles_lose_the_offsets_that_were_recorded_with_them(tmp_path: Path) -> None:
    times_ns = 10_000_000_000 + 25_000_000 * np.arange(6)
    first, second = np.arange(PHI.shape[0]), 2 * np.arange(PHI.shape[0])
    offsets = [None, first, first, second, second, second]
    source = RecordedOffsets(
        recorded(tmp_path / "run.mcap", list(zip(times_ns.tolist(), offsets, strict=True))), LAYOUT
    )
    counts = np.full((6, PHI.shape[0]), 10_000, np.int32)
    valid = np.ones(counts.shape, np.bool_)
    corrected, _, _ = calibrated_cycles(LAYOUT, counts, valid, times_ns + 1000 - 300_000, source)  # other time stamps
    for cycle, known in enumerate(offsets):
        np.testing.assert_array_equal(corrected[cycle], 10_000 - (0 if known is None else known))
    assert source.applied == 5
    assert RecordedOffsets(recorded(tmp_path / "none.mcap", [(5, None)]), LAYOUT).is_empty


def test_the_attached_calibration_of_a_recording_has_its_newest_offsets(tmp_path: Path) -> None:
    path = recorded(tmp_path / "run.mcap", [(5, np.full(PHI.shape[0], 7))])
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
