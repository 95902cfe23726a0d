"""``skin node check --live``: what the counts of the boards say of the wiring."""

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from canskin.errors import InputError
from commissioning.count_reading import CountReading
from commissioning.wiring_findings import Finding, Place, findings_of
from skin.layout import Layout
from skin.phi import Sbhe
from skin.surface import Floats
from skin.text_tables import read_table

#: Columns of the path of a finger.
_PATH: Final = ("time_s", "x_m", "y_m", "z_m")


def check_counts(layout: Layout, reading: CountReading, finger: Floats | None) -> list[Finding]:
    """Return what is not wired as the layout says, by the counts of the boards.

    Parameters
    ----------
    finger : array, shape (moments, 4), or None
        Of `finger_path`.
    """
    times_s, counts = reading.readings()
    path_m = None if finger is None else np.stack([np.interp(times_s, finger[:, 0], each) for each in finger.T[1:]], 1)
    return findings_of(layout.phi(), layout.taxels.surface, counts, path_m, reading.rest)


def finger_path(path: Path) -> Floats:
    """Return where a finger is, of a CSV: seconds after the first reading, x, y, z in metres, shape (moments, 4).

    Raises
    ------
    LayoutError, InputError
        If the file is no such table.
    """
    found = read_table(path, "path", _PATH)
    if not found.columns.keys() >= set(_PATH) or not found.rows:
        raise InputError(f"{path}: expected the header {','.join(_PATH)} and a line for each moment")
    table = np.array([found.numbers(row, _PATH) for row in found.rows])
    if not np.isfinite(table).all() or (np.diff(table[:, 0]) <= 0).any():
        raise InputError(f"{path}: expected finite numbers, and times that ascend")
    return table


def text_of(finding: Finding) -> str:
    """Return a finding in words."""
    board, place = finding.expected
    found = " and ".join(f"place {each.place} of board {each.board}" for each in finding.found)
    taxel = f"taxel {finding.taxel} of board {board}, place {place}"
    return {
        "moved": f"board {board} sits where board {finding.found[0].board if finding.found else board} should",
        "swapped": f"{taxel}, is wired to {found}",
        "doubled": f"{taxel}, is wired to {found}",
        "dead": f"{taxel}, is felt by no place",
        "unclear": f"{taxel}, is not wired so; the counts do not tell where it is",
    }[finding.kind]


def corrected_order(phi: Sbhe, findings: Sequence[Finding]) -> list[list[int]]:
    """Return the taxels of each board by place as they were found, empty places as numbers from n on.

    A taxel that no place feels, or two, stays where the layout has it.

    Raises
    ------
    InputError
        If the findings are no exchange of places.
    """
    order = phi.taxels_of_blocks.copy()
    for board, other in ((each.expected.board, each.found[0].board) for each in findings if each.kind == "moved"):
        order[board] = phi.taxels_of_blocks[other]
    moved = {each.taxel: Place(*each.found[0]) for each in findings if each.kind == "swapped"}
    held = {taxel: tuple(np.argwhere(order == taxel)[0]) for taxel in moved}
    if any(each.kind == "unclear" for each in findings) or {*map(tuple, moved.values())} != {*held.values()}:
        raise InputError(
            "the findings are no exchange of places: mend the wires, or stroke again, before a file is made"
        )
    for taxel, (board, place) in moved.items():
        order[board, place] = taxel
    return [list(map(int, board)) for board in order]


def chains_file(phi: Sbhe, order: Sequence[Sequence[int]]) -> str:
    """Return the file of `measurement.chains`."""
    out = io.StringIO()
    table = csv.writer(out, lineterminator="\n")
    table.writerow(("board", "place", "taxel"))
    for board, taxels in enumerate(order):
        table.writerows((board, place, taxel) for place, taxel in enumerate(taxels) if taxel < phi.taxels)
    return out.getvalue()
