"""A Φ from a file: any matrix of 0 and ±1, one for all frames or one for each."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from canskin.errors import InputError, LayoutError
from dbc.contract import Contract
from skin.layout import Layout, layout_text, load_layout, parse_layout
from skin.matrix import MatrixPhi, entries_of, signs_of
from tests.layouts import layout_toml

GRID = "[taxels]\nrows = 3\ncolumns = 4\n[measurement]\nensemble = 'matrix'\n"
#: Two sums of twelve taxels.
SIGNS = ("++++00000000", "-0+000000011".replace("1", "+"))


@st.composite
def matrices(draw: st.DrawFn) -> np.ndarray:
    shape = draw(st.tuples(st.integers(1, 3), st.integers(1, 6), st.integers(1, 9)))
    entries = draw(arrays(np.int8, shape, elements=st.integers(-1, 1)))
    entries[..., 0][~entries.any(axis=2)] = 1
    return entries


@given(matrices(), st.integers(1, 7), st.integers(0, 2**32 - 1))
def test_forward_and_adjoint_are_of_one_matrix(entries: np.ndarray, cycle: int, seed: int) -> None:
    phi = MatrixPhi(entries).of_cycle(cycle)
    random = np.random.default_rng(seed)
    x, y = random.normal(size=phi.shape[1]), random.normal(size=phi.shape[0])
    np.testing.assert_allclose(phi.forward(x), entries[(cycle - 1) % len(entries)] @ x)
    np.testing.assert_allclose(phi.forward(x) @ y, x @ phi.adjoint(y), atol=1e-9)
    assert np.linalg.norm(phi.forward(x)) ** 2 <= phi.norm_squared * (x @ x)


@given(matrices())
def test_the_norm_is_the_largest_of_all_frames(entries: np.ndarray) -> None:
    largest = max(np.linalg.norm(frame.astype(float), 2) ** 2 for frame in entries)
    assert MatrixPhi(entries).norm_squared == pytest.approx(largest, rel=1e-5)


@given(matrices())
def test_signs_stand_for_entries(entries: np.ndarray) -> None:
    np.testing.assert_array_equal(entries_of(signs_of(entries)), entries)


def test_each_sum_is_a_block() -> None:
    phi = MatrixPhi(np.array([[1, 1, 0, 0], [0, -1, 1, 0]]))
    came = np.array([True, False])
    assert (phi.blocks, phi.has_sums.all(), phi.starts.tolist()) == (2, True, [0, 1, 2])
    np.testing.assert_array_equal(phi.sums_of_blocks(came), came)
    np.testing.assert_array_equal(phi.all_of_blocks(came), came)
    np.testing.assert_array_equal(phi.valid_taxels(came), [True, True, False, False])


def test_a_change_of_any_entry_shows_in_the_fingerprint() -> None:
    entries = np.ones((2, 3, 4), np.int8)
    other = entries.copy()
    other[1, 2, 3] = 0
    found = {MatrixPhi(each).fingerprint for each in (entries, other, entries.reshape(3, 2, 4), entries[:1])}
    assert len(found) == 4


def test_a_phi_that_changes_is_applied_frame_by_frame() -> None:
    with pytest.raises(InputError, match="changes from frame to frame, 2 of them"):
        MatrixPhi(np.ones((2, 3, 4))).forward(np.ones(4))


def skin(text: str, folder: Path = Path()) -> Layout:
    return parse_layout(text.encode(), "wire.toml", folder)


@pytest.mark.parametrize(("suffix", "frames"), [(".csv", 1), (".npz", 1), (".npz", 3)])
def test_a_layout_reads_a_file_and_then_stands_for_itself(tmp_path: Path, suffix: str, frames: int) -> None:
    entries = np.random.default_rng(1).integers(-1, 2, (frames, 5, 12))
    if suffix == ".csv":
        np.savetxt(tmp_path / "codes.csv", entries[0], fmt="%d", delimiter=",", header="five sums")
    else:
        np.savez(tmp_path / "codes.npz", phi=entries if frames > 1 else entries[0].astype(float), other=entries)
    layout = skin(GRID + f"matrix = 'codes{suffix}'", tmp_path)
    assert (layout.measurement.sums, layout.blocks, layout.bus) == (5, 5, [])
    phi = layout.operator()
    assert isinstance(phi, MatrixPhi)
    np.testing.assert_array_equal(phi.entries, entries)
    again = skin(layout_text(layout))
    assert again == layout
    assert again.operator().fingerprint == phi.fingerprint


def test_rows_of_signs_stand_in_the_layout() -> None:
    phi = skin(GRID + f"matrix = {list(SIGNS)}").operator()
    np.testing.assert_array_equal(phi.of_cycle(7).forward(np.arange(12)), [6, 2 + 10 + 11])


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"1,0\n1,x\n", "expected lines of numbers"),
        (b"1,0\n1\n", "expected lines of numbers"),
        (b"1,0,2,0\n", "expected 0, 1 and -1, got 2.0 in row 0, column 2"),
        (b"1,nan\n", "expected 0, 1 and -1, got nan in row 0, column 1"),
        (b"1,1\n0,0\n", "row 1 has zeros alone: expected a sum of one taxel or more"),
        (b"1,1\n1,0\n", "Φ has 2 columns, expected 12, one for each taxel"),
        (b"\xff\xfe", "cannot read the matrix"),
    ],
)
def test_a_bad_csv_is_refused_in_one_line(tmp_path: Path, content: bytes, says: str) -> None:
    (tmp_path / "codes.csv").write_bytes(content)
    with pytest.raises(LayoutError) as refused:
        skin(GRID + "matrix = 'codes.csv'", tmp_path)
    assert says in str(refused.value)
    assert str(refused.value).endswith("at `$.measurement.matrix`")


@pytest.mark.parametrize(
    ("named", "says"),
    [
        ({"codes": np.ones((2, 12))}, "expected the array 'phi', got codes"),
        ({"phi": np.full((2, 12), None)}, "cannot read the matrix: expected an .npz of numbers"),
        ({"phi": np.full((2, 12), "1")}, "expected an array of 0, 1 and -1, got <U1"),
        ({"phi": np.ones(12)}, "expected the shape (sums, taxels) or (frames, sums, taxels), got (12,)"),
        ({"phi": np.ones((0, 12))}, "expected the shape (sums, taxels)"),
        ({"phi": np.full((2, 2, 12), 0.5)}, "expected 0, 1 and -1, got 0.5 in row 0, column 0, frame 0"),
        ({"phi": np.eye(3, 12)[None] * np.array([1, 0])[:, None, None]}, "row 0 of frame 1 has zeros alone"),
    ],
)
def test_a_bad_npz_is_refused_in_one_line(tmp_path: Path, named: dict[str, np.ndarray], says: str) -> None:
    np.savez(tmp_path / "codes.npz", **named)  # type: ignore[arg-type]
    with pytest.raises(LayoutError) as refused:
        skin(GRID + "matrix = 'codes.npz'", tmp_path)
    assert says in str(refused.value)


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ("", "`matrix` and ensemble = 'matrix' belong together, got 'matrix' - at `$.measurement.ensemble`"),
        ("matrix = 'gone.csv'", "gone.csv: cannot read the matrix"),
        ("matrix = []", "expected a row for each sum, got none"),
        (f"matrix = ['{SIGNS[0]}', '+']", "expected 12 signs, as in row 0, got 1 in row 1 of frame 0"),
        (
            f"matrix = [['{SIGNS[0]}'], ['{SIGNS[0]}', '{SIGNS[1]}']]",
            "expected 1 rows, as in frame 0, got 2 in frame 1",
        ),
        (
            f"matrix = {list(SIGNS)}\nsums = 3",
            "expected 2, one for each row, or no key, got 3 - at `$.measurement.sums`",
        ),
        (f"matrix = {list(SIGNS)}\nseed = 2", "leave the key out - at `$.measurement.seed`"),
        (f"matrix = {list(SIGNS)}\n[[bus]]\nname = 'can0'\nnodes = 1", "leave the key out - at `$.bus`"),
        (f"matrix = {list(SIGNS)}\n[sync]\nturns = 2", "leave the key out - at `$.sync.turns`"),
        (f"matrix = {list(SIGNS)}\n[sampling]\nrate_hz = 1000", "leave the key out - at `$.sampling.rate_hz`"),
    ],
)
def test_keys_that_do_not_fit_are_refused_in_one_line(more: str, says: str) -> None:
    with pytest.raises(LayoutError) as refused:
        skin(GRID + more)
    assert says in str(refused.value)


def test_no_sum_may_feel_a_gap() -> None:
    shape = GRID.replace("rows = 3\ncolumns = 4", "shape = ['####', '##.#', '####']")
    assert not skin(shape + f"matrix = {list(SIGNS)}").operator().is_wired[6]
    with pytest.raises(LayoutError, match="taxel 6 is a gap, but a sum of Φ feels it"):
        skin(shape + "matrix = ['++++++++++++']")


def test_what_needs_boards_refuses_a_matrix() -> None:
    with pytest.raises(LayoutError, match="made by other hardware"):
        Contract.from_layout(skin(GRID + f"matrix = {list(SIGNS)}"))


def test_a_matrix_needs_its_ensemble(tmp_path: Path) -> None:
    path = tmp_path / "small.toml"
    path.write_text(layout_toml(3, 4, measurement={"matrix": list(SIGNS)}))
    with pytest.raises(LayoutError, match="belong together, got 'sbhe'"):
        load_layout(path)
