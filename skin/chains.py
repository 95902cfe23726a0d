"""Skins that exist: where their taxels lie, which taxels each board has, and in which order."""

import contextlib
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import Final

import numpy as np

from canskin.errors import LayoutError
from skin.surface import Surface
from skin.text_tables import MOST, Row, read_table
from skin.walsh import Indices

#: A place of a board without a taxel.
EMPTY: Final = -1
#: Where a layout has the chains.
_KEY: Final = "at `$.measurement.chains`"
_HEADER: Final = "board,place,taxel or board,place,row,column"
_POSITION: Final = ("x_m", "y_m", "z_m")
_NORMAL: Final = ("nx", "ny", "nz")


def read_chains(path: Path, columns: int) -> list[list[int]]:
    """Read a file of chains: CSV with a line for each taxel.

    Parameters
    ----------
    path : pathlib.Path
        Columns `board` and `place`, both from 0, and `taxel`, row-major, or `row` and `column`.
    columns : int
        Taxels in a row of the skin.

    Returns
    -------
    list of list of int
        Of each board the taxels by place, `EMPTY` for a place that the file does not name.

    Raises
    ------
    LayoutError
        If the file is no such table, or names a place twice.
    """
    with _at(_KEY):
        table = read_table(path, "chains", ("board", "place", "taxel", "row", "column"))
        names = table.columns.keys()
        if not ({"board", "place", "taxel"} <= names or {"board", "place", "row", "column"} <= names):
            raise LayoutError(f"{path}: expected the header {_HEADER}, got {_got(names)}")
        found = _Boards()
        for row in table.rows:
            if "taxel" in names:
                found.read(row, _whole(row, "taxel"))
            else:
                found.read(row, _whole(row, "row") * columns + _whole(row, "column", columns - 1))
        return found.chains()


def read_positions(path: Path) -> tuple[list[list[float]], list[list[int]] | None]:
    """Read a file of positions: CSV with a line for each taxel.

    Parameters
    ----------
    path : pathlib.Path
        Columns `x_m`, `y_m` and `z_m`; `nx`, `ny` and `nz` if the normals are known; `board` if the boards are, and
        then `place`, without which the taxels of a board are in the order of their lines.

    Returns
    -------
    positions : list of list of float
        Three or six numbers of each taxel, positions in metres.
    chains : list of list of int or None
        Of each board the taxels by place; None without the column `board`.

    Raises
    ------
    LayoutError
        If the file is no such table, or names a place twice.
    """
    wanted = (*_POSITION, *_NORMAL, "board", "place")
    with _at("at `$.taxels.positions`"):
        table = read_table(path, "positions", wanted)
        names = table.columns.keys()
        if not names >= set(_POSITION):
            units = "or x_mm, x [mm] and so on"
            raise LayoutError(f"{path}: expected the header {','.join(_POSITION)},..., {units}, got {_got(names)}")
        if not table.rows:
            raise LayoutError(f"{path}: expected a line for each taxel, got none")
        for some, needed in ((_NORMAL, _NORMAL), (("place",), ("board", "place"))):
            if names & set(some) and not names >= set(needed):
                raise LayoutError(f"{path}: expected the columns {','.join(needed)} together, got {_got(names)}")
        has_normals = names >= set(_NORMAL)
        positions = [table.numbers(row, wanted[: 6 if has_normals else 3]) for row in table.rows]
    if "board" not in names:
        return positions, None
    boards = _Boards()
    with _at(_KEY):
        for taxel, row in enumerate(table.rows):
            boards.read(row, taxel)
    return positions, boards.chains()


def positions_text(surface: Surface, chains: Sequence[Sequence[int]] | None) -> str:
    """Return a file of positions, as `read_positions` reads it."""
    lines = [[*place, *normal] for place, normal in zip(surface.positions_m, surface.normals, strict=True)]
    texts = [[f"{value:.6g}" for value in line] for line in lines]
    for board, held in enumerate(chains or ()):
        for place, taxel in enumerate(held):
            if taxel != EMPTY:
                texts[taxel] += [str(board), str(place)]
    header = (*_POSITION, *_NORMAL, *(("board", "place") if chains else ()))
    return "\n".join(map(",".join, [header, *texts])) + "\n"


class _Boards:
    """The boards of a file, taxel by taxel."""

    def __init__(self) -> None:
        self._taxels: dict[int, dict[int, int]] = {}

    def read(self, row: Row, taxel: int) -> None:
        """Put a taxel where its line says."""
        place = _whole(row, "place") if "place" in row.values else None
        self.add(_whole(row, "board"), place, row.where, taxel)

    def add(self, board: int, place: int | None, where: str, taxel: int) -> None:
        """Put a taxel at a place on its board; None: after those before."""
        held = self._taxels.setdefault(board, {})
        place = len(held) if place is None else place
        if place in held:
            raise LayoutError(f"{where}: place {place} of board {board} is named twice")
        held[place] = taxel

    def chains(self) -> list[list[int]]:
        """Return the taxels of each board by place, `EMPTY` for a place that no line names."""
        boards = [self._taxels.get(board, {}) for board in range(max(self._taxels, default=-1) + 1)]
        return [[held.get(place, EMPTY) for place in range(max(held, default=-1) + 1)] for held in boards]


def chains_of(places: Sequence[tuple[int, int]]) -> list[list[int]]:
    """Return the taxels of each board by place, from board and place of each taxel."""
    boards = _Boards()
    for taxel, (board, place) in enumerate(places):
        boards.add(board, place, f"taxel {taxel}", taxel)
    return boards.chains()


def _whole(row: Row, name: str, most: int = MOST) -> int:
    limits = f"whole numbers from 0 to {most}"
    try:
        value = int(row.values[name])
    except ValueError as error:
        raise LayoutError(f"{row.where}: expected {limits} as {name}: {error}") from error
    if not 0 <= value <= most:
        raise LayoutError(f"{row.where}: expected {limits} as {name}, got {value}")
    return value


@contextlib.contextmanager
def _at(key: str) -> Iterator[None]:
    """Add the key of the layout that names a file to the errors of that file."""
    try:
        yield
    except LayoutError as error:
        raise LayoutError(f"{error} - {key}") from error


def _got(names: Iterable[str]) -> str:
    return ",".join(sorted(names))[:60] or "none"


def check_chains(chains: Sequence[Sequence[int]], taxels: int, block_size: int, gaps: Indices) -> None:
    """Check that the chains hold each of the taxels once, none of the gaps, and each board at most `block_size`."""
    for board, held in enumerate(chains):
        if len(held) > block_size:
            limit = f"expected at most {block_size} places (`measurement.block_size`)"
            raise LayoutError(f"{limit}, got {len(held)} of board {board} - {_KEY}")
        if all(taxel == EMPTY for taxel in held):
            raise LayoutError(f"board {board} has no taxel: number the boards from 0 without a gap - {_KEY}")
    named = Counter(taxel for taxel in chain.from_iterable(chains) if taxel != EMPTY)
    for taxel, times in named.items():
        if not 0 <= taxel < taxels:
            raise LayoutError(f"expected taxels 0 to {taxels - 1}, and {EMPTY} for none, got {taxel} - {_KEY}")
        if times > 1:
            raise LayoutError(f"taxel {taxel} is on {times} places: expected each taxel once - {_KEY}")
    lacking = set(gaps.tolist())
    if both := lacking & set(named):
        raise LayoutError(f"taxel {min(both)} is a gap of `taxels.shape`: no board can have it - {_KEY}")
    missing = [taxel for taxel in range(taxels) if taxel not in named and taxel not in lacking]
    if missing:
        named_first = (
            f"taxel {missing[0]} is" if len(missing) == 1 else f"taxel {missing[0]} and {len(missing) - 1} more are"
        )
        raise LayoutError(f"{named_first} on no board: expected each taxel once - {_KEY}")


def order_of(chains: Sequence[Sequence[int]], taxels: int, block_size: int) -> Indices:
    """Return the order of an SBHE, shape (boards * block_size,): empty places are numbered after the taxels."""
    order = np.full((len(chains), block_size), EMPTY, np.intp)
    for held, board in zip(chains, order, strict=True):
        board[: len(held)] = held
    flat = order.ravel()
    empty = flat == EMPTY
    flat[empty] = np.arange(taxels, taxels + empty.sum())
    return flat
