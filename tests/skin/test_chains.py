"""Boards that exist: their taxels from a file, and one clear error for each thing that cannot be."""

from pathlib import Path

import numpy as np
import pytest

from canskin.errors import LayoutError
from skin.chains import read_chains, read_positions
from skin.layout import Layout, layout_text, load_layout, parse_layout

#: A mat of 4 x 6 taxels on boards of 12, 8 and 4.
SIZES = (12, 8, 4)
BOARDS = [(board, place) for board, size in enumerate(SIZES) for place in range(size)]


def written(folder: Path, lines: str, header: str = "board,place,taxel") -> Path:
    (folder / "boards.csv").write_text(f"{header}\n{lines}\n")
    path = folder / "mat.toml"
    path.write_text(
        "[taxels]\nrows = 4\ncolumns = 6\n[measurement]\nblock_size = 16\nwiring = 'file'\nchains = 'boards.csv'\n"
    )
    return path


def mat(folder: Path) -> Layout:
    lines = "\n".join(f"{board},{place},{23 - taxel}" for taxel, (board, place) in enumerate(BOARDS))
    return load_layout(written(folder, lines))


def test_boards_of_unequal_size(tmp_path: Path) -> None:
    layout = mat(tmp_path)
    phi = layout.phi()
    assert (layout.blocks, phi.empty, phi.shape[1]) == (3, 24, 24)
    assert [phi.taxels_of(block).tolist() for block in range(3)] == [
        list(range(23, 11, -1)),
        list(range(11, 3, -1)),
        [3, 2, 1, 0],
    ]
    signs = np.asarray(phi.wired.forward(np.eye(48))).T
    np.testing.assert_array_equal(signs @ signs.T, 16 * np.eye(len(signs)))


def test_the_text_of_a_layout_needs_no_file(tmp_path: Path) -> None:
    layout = mat(tmp_path)
    assert parse_layout(layout_text(layout).encode(), "elsewhere.toml") == layout


def test_rows_and_columns_in_place_of_taxels(tmp_path: Path) -> None:
    lines = "\n".join(f"{board}, {place}, {taxel // 6}, {taxel % 6}" for taxel, (board, place) in enumerate(BOARDS))
    layout = load_layout(written(tmp_path, lines, "board,place,row,column"))
    assert layout.phi().taxels_of(1).tolist() == list(range(12, 20))


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("1,3,15", "1,3,14", "taxel 14 is on 2 places"),
        ("1,3,15", "", "taxel 15 is on no board"),
        ("1,3,15", "1,3,24", "expected taxels 0 to 23, and -1 for none, got 24"),
        ("1,3,15", "1,16,15", "expected at most 16 places .*, got 17 of board 1"),
        ("1,3,15", "1,2,15", "line 17: place 2 of board 1 is named twice"),
        ("1,3,15", "1,3,nan", "line 17: expected whole numbers from 0 to 65535 as taxel: .*nan"),
        ("1,3,15", "1,3", "line 17: expected 3 values, as in the header, got 2"),
        ("1,3,15", "1,-3,15", "line 17: expected whole numbers from 0 to 65535 as place, got -3"),
        ("1,3,15", "9,3,15", "board 3 has no taxel"),
        ("board,place", "node,place", "expected the header board,place,taxel"),
    ],
)
def test_errors(tmp_path: Path, old: str, new: str, says: str) -> None:
    lines = "\n".join(f"{board},{place},{taxel}" for taxel, (board, place) in enumerate(BOARDS))
    path = written(tmp_path, lines)
    text = (tmp_path / "boards.csv").read_text()
    assert old in text
    (tmp_path / "boards.csv").write_text(text.replace(old, new, 1))
    with pytest.raises(LayoutError, match=says) as caught:
        load_layout(path)
    assert str(caught.value).endswith("at `$.measurement.chains`")
    assert "\n" not in str(caught.value)


def test_a_column_beyond_the_skin(tmp_path: Path) -> None:
    (tmp_path / "boards.csv").write_text("board,place,row,column\n0,0,0,6\n")
    with pytest.raises(LayoutError, match="line 2: expected whole numbers from 0 to 5 as column, got 6"):
        read_chains(tmp_path / "boards.csv", 6)


@pytest.mark.parametrize(
    ("tables", "says"),
    [
        ("chains = [[0]]", "boards from a file need 'file', got 'scattered'"),
        ("wiring = 'file'", "'file' needs `chains`"),
    ],
)
def test_chains_and_wiring_go_together(tables: str, says: str) -> None:
    with pytest.raises(LayoutError, match=says):
        parse_layout(f"[taxels]\nrows = 4\ncolumns = 6\n[measurement]\n{tables}\n".encode(), "mat.toml")


def test_no_file(tmp_path: Path) -> None:
    path = written(tmp_path, "")
    (tmp_path / "boards.csv").unlink()
    with pytest.raises(LayoutError, match=r"boards\.csv: cannot read the chains"):
        load_layout(path)


HEADER = "x_m,y_m,z_m"
#: A strip of 12 taxels on two boards, the first of 8.
STRIP = [(0.004 * taxel, 0.0, 0.0) for taxel in range(12)]


def with_positions(folder: Path, header: str, lines: list[str], more: str = "") -> Path:
    (folder / "strip.csv").write_text("\n".join([header, *lines]) + "\n")
    path = folder / "strip.toml"
    path.write_text(f"[taxels]\npositions = 'strip.csv'\n{more}")
    return path


def strip_lines(*, boards: bool) -> list[str]:
    return [",".join(map(str, (*place, *((taxel // 8,) if boards else ())))) for taxel, place in enumerate(STRIP)]


def test_positions_make_a_skin_of_one_row_whose_own_text_is_whole(tmp_path: Path) -> None:
    layout = load_layout(with_positions(tmp_path, HEADER, strip_lines(boards=False)))
    assert (layout.taxels.rows, layout.taxels.columns, layout.blocks) == (1, 12, 1)
    assert layout.taxels.pitch_m == pytest.approx(0.004)
    assert layout.taxels.surface.edges.tolist() == [[taxel, taxel + 1] for taxel in range(11)]
    assert parse_layout(layout_text(layout).encode(), "again") == layout


def test_positions_may_name_the_boards(tmp_path: Path) -> None:
    layout = load_layout(with_positions(tmp_path, f"{HEADER},board", strip_lines(boards=True)))
    assert layout.measurement.wiring == "file"
    assert layout.measurement.chains == (tuple(range(8)), tuple(range(8, 12)))


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "latin-1"])
@pytest.mark.parametrize(
    ("header", "line"),
    [
        ("# größe\n\nx_m,y_m,z_m", "{x},{y},0"),
        ("date,x_mm,y_mm,z_mm", "2026-01-01,{x_mm},{y_mm},0"),
        ("X [mm], Y [mm], Z [mm], größe", "{x_mm}, {y_mm}, 0, 1"),
        ('sep=;\n"x_m";"y (cm)";z / mm;', "{x};0,5;0;"),
        ("x_m\ty_m\tz_m\tname", '{x}\t{y}\t0\t"a, b"'),
    ],
    ids=["comments", "date", "brackets", "semicolons", "tabs"],
)
def test_positions_of_other_programs(tmp_path: Path, header: str, line: str, encoding: str) -> None:
    places = [(0.0005 * taxel + 0.001, 0.005) for taxel in range(12)]
    lines = [line.format(x=x, y=y, x_mm=1e3 * x, y_mm=1e3 * y) for x, y in places]
    if ";" in header:
        lines = [each.replace(".", ",") for each in lines]
    path = tmp_path / "strip.csv"
    path.write_bytes("\r\n".join([header, *lines, ",,," * ("date" in header), ""]).encode(encoding))
    positions, chains = read_positions(path)
    assert chains is None
    np.testing.assert_allclose(positions, [(*place, 0.0) for place in places], atol=1e-15)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "latin-1"])
def test_a_layout_may_have_the_encoding_of_an_editor(tmp_path: Path, encoding: str) -> None:
    path = tmp_path / "mat.toml"
    path.write_bytes("# Größe\n[taxels]\nrows = 8\ncolumns = 8\n".encode(encoding))
    assert load_layout(path).taxels.count == 64


@pytest.mark.parametrize(
    ("header", "lines", "more", "words"),
    [
        ("x,y,z", ["0,0,0"], "", "expected the header x_m,y_m,z_m,..., .*got x,y,z"),
        (HEADER, ["0,0"], "", "line 2: expected 3 values, as in the header, got 2"),
        (HEADER, ["0,5,0,25,0,1"], "", "got 6; decimal commas need ';' between the values"),
        (f"{HEADER},x_mm", ["0,0,0,0"], "", "expected each column once, got x_m twice"),
        (f"{HEADER},nx,ny", ["0,0,0,0,0"], "", "expected the columns nx,ny,nz together"),
        (f"{HEADER},place", ["0,0,0,0"], "", "expected the columns board,place together"),
        (HEADER, ["0,0,0", "0,zero,0"], "", "line 3: expected numbers"),
        (HEADER, [], "", "expected a line for each taxel, got none"),
        (HEADER, strip_lines(boards=False), "rows = 3", "are no grid: leave rows"),
        (HEADER, strip_lines(boards=False), "pitch_m = 0.1", "expected the median spacing, 0.004"),
        (f"{HEADER},board,place", ["0,0,0,0,0", "0.004,0,0,0,0"], "", "line 3: place 0 of board 0 is named twice"),
        (f"{HEADER},board", ["0,0,0,-1"], "", "whole numbers from 0 to 65535 as board, got -1"),
    ],
)
def test_wrong_files_of_positions_have_one_clear_error(
    tmp_path: Path, header: str, lines: list[str], more: str, words: str
) -> None:
    with pytest.raises(LayoutError, match=words):
        load_layout(with_positions(tmp_path, header, lines, more))
