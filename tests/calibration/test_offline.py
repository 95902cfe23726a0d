"""Runs that were recorded without calibration."""

from pathlib import Path

import numpy as np
import pytest

from calibration.calibrator import Calibrator
from calibration.offline import calibrated_cycles, make_calibrator
from calibration.stored import save_calibration, store
from skin.errors import InputError
from skin.layout import load_layout
from tests.calibration.skins import LAYOUT, NEWTON_PER_COUNT, PHI, offsets_n, pressed

OFFSETS = PHI.forward(offsets_n())


def test_cycles_lose_their_offsets_when_the_zero_is_measured() -> None:
    noise = np.random.default_rng(0).normal(0, 2e-4, (500, PHI.shape[0]))
    touch_n = np.zeros((500, PHI.shape[0]))
    touch_n[400:] = PHI.forward(pressed(20, 20, 9, 5e-3))
    counts = np.rint((OFFSETS + noise + touch_n) / NEWTON_PER_COUNT).astype(np.int32)
    valid = np.ones((500, PHI.blocks), np.bool_)
    valid[450, 7] = False
    corrected, whole = calibrated_cycles(LAYOUT, counts, valid, Calibrator(LAYOUT))
    assert (whole == valid).all()
    np.testing.assert_array_equal(corrected[:100], counts[:100])
    error_n = corrected[350:] * NEWTON_PER_COUNT - touch_n[350:]
    error_n[100, PHI.block_of_sum == 7] = 0
    assert error_n.std() < 3e-4
    assert not corrected[450, PHI.block_of_sum == 7].any()


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
