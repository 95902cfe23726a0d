"""Which taxels each board has, and in which order: of boards that exist, from a file or from lists."""

import csv
from collections import Counter
from collections.abc import Sequence
from itertools import chain
from pathlib import Path
from typing import Final

import numpy as np

from canskin.errors import LayoutError
from skin.walsh import Indices

#: A place of a board without a taxel.
EMPTY: Final = -1
#: Where a layout has the chains.
_KEY: Final = "at `$.measurement.chains`"
_HEADER: Final = "board,place,taxel or board,place,row,column"


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
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            table = csv.DictReader(file, skipinitialspace=True)
            names, lines = set(table.fieldnames or ()), list(table)
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise LayoutError(f"{path}: cannot read the chains: {error} - {_KEY}") from error
    if not ({"board", "place", "taxel"} <= names or {"board", "place", "row", "column"} <= names):
        raise LayoutError(
            f"{path}: expected the header {_HEADER}, got {','.join(sorted(names))[:60] or 'none'} - {_KEY}"
        )
    boards: dict[int, dict[int, int]] = {}
    for number, line in enumerate(lines, 2):
        try:
            board, place = int(line["board"]), int(line["place"])
            taxel = int(line["taxel"]) if "taxel" in names else int(line["row"]) * columns + int(line["column"])
            is_in_row = "taxel" in names or 0 <= int(line["column"]) < columns
        except (TypeError, ValueError) as error:
            raise LayoutError(f"{path}, line {number}: expected whole numbers: {error} - {_KEY}") from error
        if min(board, place, taxel) < 0 or max(board, place) > np.iinfo(np.uint16).max or not is_in_row:
            limits = f"numbers from 0 and columns below {columns}"
            raise LayoutError(f"{path}, line {number}: expected {limits}, got {_words(line)} - {_KEY}")
        if place in boards.setdefault(board, {}):
            raise LayoutError(f"{path}, line {number}: place {place} of board {board} is named twice - {_KEY}")
        boards[board][place] = taxel
    return [
        [held.get(place, EMPTY) for place in range(max(held, default=-1) + 1)]
        for held in (boards.get(board, {}) for board in range(max(boards, default=-1) + 1))
    ]


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


def _words(line: dict[str, str]) -> str:
    return ", ".join(f"{name} {value}" for name, value in line.items())
