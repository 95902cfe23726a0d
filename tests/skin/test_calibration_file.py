"""Calibrations in files."""

from datetime import datetime, timedelta
from pathlib import Path

import msgspec
import numpy as np
import pytest

from canskin.errors import InputError
from skin.calibration_file import encoded, load_calibration, new_calibration
from skin.defects import SumGains
from tests.calibration.helpers import LAYOUT, PHI


def test_a_file_holds_what_was_stored(tmp_path: Path) -> None:
    offsets_n = np.linspace(-0.1, 0.1, PHI.shape[0])
    offsets_n[5] = np.nan
    gains = np.linspace(0.9, 1.1, PHI.shape[1])
    stored = new_calibration(LAYOUT, offsets_n=offsets_n, gains=gains, defects=["sum 3 is stuck"])
    (tmp_path / "it.json").write_bytes(encoded(stored))
    loaded = load_calibration(tmp_path / "it.json", LAYOUT)
    np.testing.assert_array_equal(loaded.sum_offsets_n(), offsets_n)
    np.testing.assert_array_equal(loaded.gains, gains)
    assert loaded.defects == ["sum 3 is stuck"]


def test_a_file_without_gains_of_sums_is_of_version_1_as_is_a_file_that_names_none(tmp_path: Path) -> None:
    """Programs from before the gains of sums read version 1."""
    path = tmp_path / "it.json"
    path.write_bytes(encoded(new_calibration(LAYOUT, gains=np.ones(PHI.shape[1]))))
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
    path.write_bytes(msgspec.json.encode(msgspec.to_builtins(new_calibration(LAYOUT)) | changed))
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


@pytest.mark.parametrize(
    ("name", "size", "most"),
    [
        ("offsets_n", 1024, 0.64),  # 32 taxels of 20 mN
        ("taxel_offsets_n", 4096, 0.02),
        ("gains", 4096, 100.0),
        ("differential_gains", 1024, 100.0),
        ("common_mode_gains", 1024, 100.0),
    ],
)
def test_values_up_to_the_largest_that_a_skin_can_have_are_read(
    name: str, size: int, most: float, tmp_path: Path
) -> None:
    path = tmp_path / "it.json"
    both = {"differential_gains": [1.0] * 1024, "common_mode_gains": [0.0] * 1024}
    others = both if name in both else {}

    def load(values: list[float]) -> list[float]:
        path.write_bytes(msgspec.json.encode(msgspec.to_builtins(new_calibration(LAYOUT)) | others | {name: values}))
        return list(getattr(load_calibration(path, LAYOUT), name))

    values = [most] * size
    assert load(values) == values
    values[-1] = 1.001 * most
    with pytest.raises(InputError):
        load(values)
    with pytest.raises(InputError, match=f"expected {size} {name}, or none, got {size - 1}"):
        load([most] * (size - 1))
    if name.endswith("_n"):
        assert load([-most] * size) == [-most] * size
        with pytest.raises(InputError, match=rf"{name} that this skin cannot have: expected -{most:g} to {most:g}"):
            load([-1.001 * most] * size)


def test_gains_are_stored_between_a_hundredth_and_a_hundred() -> None:
    wide = np.ones(PHI.shape[1])
    wide[:4] = 0.001, 0.01, 100, 2000
    of_sums = SumGains(np.linspace(-1, 200, PHI.shape[0]), np.linspace(-300, 300, PHI.shape[0]))
    made = new_calibration(LAYOUT, gains=wide, sum_gains=of_sums)
    assert made.gains[:5] == [0.01, 0.01, 100, 100, 1]
    assert (made.differential_gains[0], made.differential_gains[-1]) == (0.01, 100)
    assert (made.common_mode_gains[0], made.common_mode_gains[-1]) == (-100, 100)
    assert (made.version, new_calibration(LAYOUT, gains=wide).version) == (2, 1)
    assert (made.skin, made.fingerprint, made.force_max_n) == (LAYOUT.name, PHI.fingerprint, 0.02)
    assert (made.offsets_n, made.defects, made.taxel_offsets_n) == ([], [], [])
    found = made.sum_gains()
    assert found is not None
    assert found.differential.tolist() == made.differential_gains
    assert found.common_mode.tolist() == made.common_mode_gains


def test_what_is_not_there_is_none_and_a_calibration_without_offsets_says_what_to_do() -> None:
    empty = new_calibration(LAYOUT)
    assert (empty.sum_gains(), empty.sum_offsets_n()) == (None, None)
    with pytest.raises(InputError, match=r"^the file: has no offsets of sums: .*'skin calibration load --to-nodes'$"):
        empty.required_offsets_n("the file")
    offsets_n = np.full(PHI.shape[0], 0.01)
    offsets_n[[0, 9]] = np.nan
    made = new_calibration(LAYOUT, offsets_n=offsets_n)
    assert [place for place, each in enumerate(made.offsets_n) if each is None] == [0, 9]
    np.testing.assert_array_equal(made.required_offsets_n("the file"), offsets_n)


def test_a_calibration_is_stamped_with_the_time_in_utc() -> None:
    saved = datetime.fromisoformat(new_calibration(LAYOUT).saved)
    assert saved.utcoffset() == timedelta(0)
    assert saved.microsecond == 0


def test_a_file_ends_with_a_line_end() -> None:
    assert encoded(new_calibration(LAYOUT)).endswith(b"}\n")


def test_of_long_names_the_first_64_and_32_characters_are_told(tmp_path: Path) -> None:
    path = tmp_path / "it.json"
    other = {"skin": "n" * 100, "fingerprint": "f" * 50}
    path.write_bytes(msgspec.json.encode(msgspec.to_builtins(new_calibration(LAYOUT)) | other))
    told = "'" + "n" * 64 + "' with Φ " + "f" * 32 + " and 0.02 N: expected 'skin' with Φ " + PHI.fingerprint
    with pytest.raises(InputError, match=told):
        load_calibration(path, LAYOUT)
