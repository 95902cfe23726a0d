"""Calibrations in files."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from calibration.stored import load_calibration, save_calibration, store
from canskin.errors import InputError
from tests.calibration.skins import LAYOUT, PHI


def test_a_file_holds_what_was_stored(tmp_path: Path) -> None:
    offsets_n = np.linspace(-0.1, 0.1, PHI.shape[0])
    offsets_n[5] = np.nan
    gains = np.linspace(0.9, 1.1, PHI.shape[1])
    save_calibration(tmp_path / "it.json", store(LAYOUT, offsets_n=offsets_n, gains=gains, defects=["sum 3 is stuck"]))
    loaded = load_calibration(tmp_path / "it.json", LAYOUT)
    np.testing.assert_array_equal(loaded.sum_offsets_n(), offsets_n)
    np.testing.assert_array_equal(loaded.gains, gains)
    assert loaded.defects == ["sum 3 is stuck"]


def test_a_file_without_gains_of_sums_is_of_version_1_as_is_a_file_that_names_none(tmp_path: Path) -> None:
    """Programs from before the gains of sums read version 1."""
    path = tmp_path / "it.json"
    save_calibration(path, store(LAYOUT, gains=np.ones(PHI.shape[1])))
    written = msgspec.json.decode(path.read_bytes())
    assert written.pop("version", 1) == 1
    path.write_bytes(msgspec.json.encode(written))
    assert load_calibration(path, LAYOUT).version == 1


BAD = (
    ({"fingerprint": "0" * 16}, "the calibration of another layout"),
    ({"force_max_n": 0.04}, "and 0.04 N: expected"),
    ({"offsets_n": [1.0]}, "expected 1024 offsets_n, or none, got 1"),
    ({"offsets_n": [1.0] * PHI.shape[0]}, "offsets_n that this skin cannot have: expected -0.64 to 0.64"),
    ({"taxel_offsets_n": [0.03] * PHI.shape[1]}, "taxel_offsets_n that this skin cannot have: expected -0.02 to 0.02"),
    ({"gains": [0.0] * PHI.shape[1]}, "expected a file of 'skin calibration save'"),
    ({"differential_gains": [1.0] * PHI.shape[0]}, "expected differential_gains and common_mode_gains, or neither"),
    ({"version": 3, "news": 1}, "a calibration of version 3, expected 2 at most: update canskin"),
    ({"more": 1}, "expected a file of 'skin calibration save'"),
)


@pytest.mark.parametrize(("changed", "said"), BAD)
def test_what_does_not_fit_is_refused_in_one_line(changed: dict[str, object], said: str, tmp_path: Path) -> None:
    path = tmp_path / "it.json"
    path.write_bytes(msgspec.json.encode(msgspec.to_builtins(store(LAYOUT)) | changed))
    with pytest.raises(InputError, match=said) as caught:
        load_calibration(path, LAYOUT)
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize("content", [b"", b"\xff\xfe", b"[" * 100_000, b"{}"])
def test_what_is_no_calibration_is_refused(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "it.json").write_bytes(content)
    with pytest.raises(InputError, match="expected a file"):
        load_calibration(tmp_path / "it.json", LAYOUT)
    with pytest.raises(InputError, match="cannot read the calibration"):
        load_calibration(tmp_path / "none.json", LAYOUT)
