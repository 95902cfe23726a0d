import io
import os
import pickle
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from canskin.errors import InputError
from skin.sources import load_source
from touch.recording import Recording
from touch.sources import recording

RNG = np.random.default_rng(3)
COUNTS = RNG.integers(0, 4096, (5, 6, 4), np.uint16)
OTHER = RNG.integers(0, 3000, (7, 6, 3), np.uint16)


@pytest.fixture
def pair(tmp_path: Path) -> Path:
    path = tmp_path / "pair.npz"
    np.savez_compressed(path, left=COUNTS, right=OTHER)
    return path


def placed(source: Recording, step: int) -> npt.NDArray[np.float64]:
    return np.rint(source.frame(step).force_n.astype(np.float64) * source.full_scale / source.force_max_n)


def test_it_is_the_source_registered_as_recording(pair: Path) -> None:
    source = load_source("recording", path=pair, rows=8, columns=8, rate_hz=100.0)
    assert isinstance(source, Recording)
    assert source.has_noise
    assert source.frame(0).label == ""
    assert source.frame(0).force_n.dtype == np.float32


def test_the_first_array_lies_in_the_middle_and_loops(pair: Path) -> None:
    source = recording(pair, 9, 8)
    assert (source.frames, source.corner) == (5, (1, 2))
    for step in (0, 3, 4, 5, 13):
        expected = np.zeros((9, 8))
        expected[1:7, 2:6] = COUNTS[step % 5]
        np.testing.assert_array_equal(placed(source, step), expected)


def test_full_scale_becomes_the_largest_force(pair: Path) -> None:
    source = recording(pair, 6, 4)
    assert source.full_scale == COUNTS.max()
    peak = max(float(source.frame(step).force_n.max()) for step in range(5))
    assert peak == pytest.approx(0.02, rel=1e-6)
    given_scale = recording(pair, 6, 4, full_scale=8190, force_max_n=0.04)
    np.testing.assert_allclose(given_scale.frame(2).force_n, COUNTS[2] / 8190 * 0.04, rtol=1e-6)


@pytest.mark.parametrize("names", [("right", "left"), "right, left"])
def test_two_arrays_lie_side_by_side(pair: Path, names: Any) -> None:
    source = recording(pair, 6, 8, arrays=names)
    assert source.frames == 5
    assert source.full_scale == max(COUNTS.max(), OTHER.max())
    np.testing.assert_array_equal(placed(source, 3)[:, :7], np.concatenate([OTHER[3], COUNTS[3]], axis=1))


def test_frames_last_as_long_as_recorded(pair: Path) -> None:
    source = recording(pair, 6, 4, rate_hz=100.0, frame_rate_hz=40.0)
    shown = [int(np.flatnonzero((placed(source, step) == COUNTS).all(axis=(1, 2)))[0]) for step in range(8)]
    assert shown == [0, 0, 0, 1, 1, 2, 2, 2]


@given(st.sampled_from(["u1", "u2", "i4", "f4", "f8", "f2"]), st.floats(1e-6, 1e6), st.integers(0, 2**32 - 1))
@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_every_unit_and_type_comes_back(tmp_path: Path, dtype: str, force_max_n: float, seed: int) -> None:
    counts = np.random.default_rng(seed).integers(0, 200, (2, 3, 3)).astype(dtype)
    counts[0, 0, 0] = 200
    path = tmp_path / "any.npy"
    np.save(path, counts)
    source = recording(path, 3, 3, force_max_n=force_max_n)
    for step in (0, 1):
        np.testing.assert_allclose(placed(source, step), counts[step], rtol=1e-6)
        if counts.dtype.kind != "f":
            np.testing.assert_array_equal(placed(source, step), counts[step])


def test_a_recording_smaller_than_the_skin_is_said(pair: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording(pair, 9, 8, arrays="left")
    assert "6 x 4 taxels of pair.npz lie in the middle of a skin of 9 x 8" in capsys.readouterr().err
    recording(pair, 6, 4, arrays="left")
    assert capsys.readouterr().err == ""


def npy(array: npt.NDArray[Any]) -> bytes:
    out = io.BytesIO()
    np.save(out, array, allow_pickle=array.dtype.hasobject)
    return out.getvalue()


def with_value(value: float) -> npt.NDArray[np.float64]:
    counts = COUNTS.astype(np.float64)
    counts[1, 2, 3] = value
    return counts


BAD_ARRAYS: dict[str, tuple[npt.NDArray[Any], str]] = {
    "bool": (COUNTS > 5, "holds bool: expected integers or real numbers"),
    "complex": (COUNTS.astype(np.complex128), "holds complex128"),
    "text": (COUNTS.astype(np.str_), "expected integers or real numbers"),
    "object": (COUNTS.astype(object), "cannot be read"),
    "two axes": (COUNTS[0], r"shape \(6, 4\): expected \(time, rows, columns\)"),
    "no frame": (COUNTS[:0], r"shape \(0, 6, 4\)"),
    "nan": (with_value(np.nan), "NaN or infinity"),
    "infinite": (with_value(np.inf), "NaN or infinity"),
    "negative": (with_value(-2.0), r"holds -2.0: expected forces of 0 or more"),
    "all zero": (COUNTS * 0, "only zeros: give the value of the largest force with --full-scale"),
    "too large": (np.ones((2, 6, 9)), "6 x 9 taxels does not fit a skin of 8 x 8"),
}


@pytest.mark.parametrize("case", BAD_ARRAYS)
def test_arrays_that_are_no_touch_are_refused(tmp_path: Path, case: str) -> None:
    array, message = BAD_ARRAYS[case]
    (tmp_path / "bad.npy").write_bytes(npy(array))
    np.savez(tmp_path / "bad.npz", array)
    for name in ("bad.npy", "bad.npz"):
        with pytest.raises(InputError, match=message) as refused:
            recording(tmp_path / name, 8, 8)
        assert "\n" not in str(refused.value)


BAD_CALLS: dict[str, tuple[Callable[[Path], Any], str]] = {
    "missing": (lambda path: recording(path.with_name("none.npz"), 8, 8), "no recording at"),
    "folder": (lambda path: recording(path.parent, 8, 8), "no recording at"),
    "array": (
        lambda path: recording(path, 8, 8, arrays=("middle",)),
        "no array 'middle': expected one of left, right",
    ),
    "no array": (lambda path: recording(path, 8, 8, arrays=()), "no array named"),
    "scale": (lambda path: recording(path, 8, 8, full_scale=0), "--full-scale. needs a number above 0"),
    "scale nan": (lambda path: recording(path, 8, 8, full_scale=float("nan")), "full-scale"),
    "scale tiny": (lambda path: recording(path, 8, 8, full_scale=1e-300), "too small"),
    "force": (lambda path: recording(path, 8, 8, force_max_n=-1), "force_max_n"),
    "wide": (lambda path: recording(path, 6, 6, arrays=("left", "right")), "6 x 7 taxels does not fit"),
    "rate": (lambda path: recording(path, 8, 8, frame_rate_hz=10.0), "--rate"),
    "step": (lambda path: recording(path, 8, 8).frame(-1), "step 0"),
}


@pytest.mark.parametrize("case", BAD_CALLS)
def test_wrong_options_are_refused(pair: Path, case: str) -> None:
    call, message = BAD_CALLS[case]
    with pytest.raises(InputError, match=message):
        call(pair)


def test_names_rows_and_file_kinds_must_fit(tmp_path: Path) -> None:
    np.savez(tmp_path / "rows.npz", tall=COUNTS, short=OTHER[:, :4])
    with pytest.raises(InputError, match=r"as many rows each: got \[4, 6\]"):
        recording(tmp_path / "rows.npz", 8, 8, arrays=("tall", "short"))
    np.save(tmp_path / "one.npy", COUNTS)
    with pytest.raises(InputError, match="no named arrays"):
        recording(tmp_path / "one.npy", 8, 8, arrays=("left",))
    (tmp_path / "one.npy").rename(tmp_path / "one.npz")
    with pytest.raises(InputError, match="one array without a name"):
        recording(tmp_path / "one.npz", 8, 8, arrays=("left",))
    (tmp_path / "one.txt").write_text("1,2")
    with pytest.raises(InputError, match="is no recording"):
        recording(tmp_path / "one.txt", 8, 8)
    with zipfile.ZipFile(tmp_path / "empty.npz", "w"):
        pass
    with pytest.raises(InputError, match="holds no array"):
        recording(tmp_path / "empty.npz", 8, 8)


class Trap:
    def __reduce__(self) -> tuple[Any, ...]:
        return (pytest.fail, ("a pickle was loaded",))


def test_no_pickle_is_ever_loaded(tmp_path: Path) -> None:
    trap = np.empty((1, 1, 1), object)
    trap[0, 0, 0] = Trap()
    (tmp_path / "trap.npy").write_bytes(npy(trap))
    (tmp_path / "raw.npy").write_bytes(pickle.dumps(Trap()))
    with zipfile.ZipFile(tmp_path / "trap.npz", "w") as archive:
        archive.writestr("a.npy", npy(trap))
    for name in ("trap.npy", "raw.npy", "trap.npz"):
        with pytest.raises(InputError, match="cannot be read"):
            recording(tmp_path / name, 8, 8)


def zipped() -> bytes:
    out = io.BytesIO()
    np.savez_compressed(out, left=COUNTS, right=OTHER)
    return out.getvalue()


@pytest.mark.heavy
@given(
    st.sampled_from(
        [
            (".npy", npy(COUNTS)),
            (".npz", zipped()),
        ]
    ),
    st.lists(st.tuples(st.integers(0, 2000), st.integers(0, 255)), min_size=1, max_size=8),
    st.integers(0, 2000),
)
@settings(max_examples=400, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
def test_a_damaged_file_is_read_or_refused(
    tmp_path: Path, kind: tuple[str, bytes], flips: list[tuple[int, int]], cut: int
) -> None:
    suffix, content = kind
    damaged = bytearray(content)
    for at, value in flips:
        damaged[at % len(damaged)] = value
    path = tmp_path / f"damaged{suffix}"
    path.write_bytes(damaged[: max(1, cut)])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # NumPy warns of odd headers before it refuses them
        try:
            source = recording(path, 8, 8)
        except InputError as refused:
            assert "\n" not in str(refused)  # noqa: PT017 - reading it is as good as refusing it
            return
    assert np.isfinite(source.frame(0).force_n).all()


@pytest.mark.skipif("SKIN_DATA" not in os.environ, reason="NOT TESTED: a real pressure mat, for want of SKIN_DATA")
def test_a_real_pressure_mat_fills_the_skin() -> None:
    path = Path(os.environ["SKIN_DATA"]) / "pressure-mat" / "S1.npz"
    source = recording(path, 64, 64, arrays=("posture_01", "posture_02"), full_scale=4095)
    with np.load(path) as saved:
        left, right = saved["posture_01"], saved["posture_02"]
    assert source.frames == min(len(left), len(right))
    for step in range(source.frames):
        np.testing.assert_array_equal(placed(source, step), np.concatenate([left[step], right[step]], axis=1))


def test_the_array_played_is_named_beside_the_others(
    pair: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording(pair, 6, 4)
    said = "recording: plays the array left of pair.npz; choose with --array, there is also right\n"
    assert capsys.readouterr().err == said
    many = tmp_path / "many.npz"
    np.savez(many, **{f"a{number}": COUNTS for number in range(12)})
    recording(many, 6, 4)
    assert capsys.readouterr().err.endswith("there is also a1, a2, a3, a4, a5, a6, a7, a8 and 3 more\n")
    single = tmp_path / "single.npz"
    np.savez(single, only=COUNTS)
    for path, arrays, columns in ((pair, "right", 3), (pair, ["left", "right"], 7), (single, None, 4)):
        recording(path, 6, columns, arrays=arrays)
    assert capsys.readouterr().err == ""


def test_stamps_and_words_beside_the_images_are_no_recording(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stamps, about = np.arange(5) * 0.01, np.array("a glove")
    np.savez(tmp_path / "hand.npz", timestamp=stamps, about=about, objects=np.array([{}]), hand=COUNTS)
    np.testing.assert_array_equal(placed(recording(tmp_path / "hand.npz", 6, 4), 3), COUNTS[3])
    assert capsys.readouterr().err == ""
    np.savez(tmp_path / "flat.npz", timestamp=stamps, hand=COUNTS.reshape(5, -1))
    with pytest.raises(
        InputError, match=r"'timestamp' of shape \(5,\), 'hand' of shape \(5, 24\): expected .time, rows, columns"
    ):
        recording(tmp_path / "flat.npz", 6, 4)


def test_a_recording_that_is_high_at_rest_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A glove that reads 2135 at rest and 0 when pressed; and one with a zero point that nobody took off."""
    np.save(tmp_path / "glove.npy", np.where(COUNTS > 3500, 0, 2135 - COUNTS % 30))
    np.save(tmp_path / "zero.npy", 2000 + COUNTS % 100)
    touches = np.where(COUNTS > 3000, COUNTS, COUNTS % 30)
    np.save(tmp_path / "touch.npy", touches)
    for name in ("glove", "zero", "touch"):
        recording(tmp_path / f"{name}.npy", 6, 4)
        assert ("is high at rest" in capsys.readouterr().err) == (name != "touch")
