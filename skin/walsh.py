"""Patches of neighbouring taxels, and the Walsh rows of a patch by sequency.

A board that is wired to its own patch measures blocks of neighbours. The Walsh rows of a patch are products of a
vertical and a horizontal Walsh function; the sequency of each is its number of sign changes. The rows of low sequency
alone give a coarse image, so that sums can be sent in order of weight.
"""

from collections.abc import Callable, Sequence
from functools import cache
from typing import Final

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError
from skin.phi import fast_hadamard
from skin.surface import Surface

#: Rows of a group: `_GROUP_SHAPE` vertical and horizontal sequencies that follow each other.
GROUP_ROWS: Final = 8
_GROUP_SHAPE: Final = (2, 4)

Indices = npt.NDArray[np.intp]


def patch_shape(taxels: int) -> tuple[int, int]:
    """Return height and width of a patch of 2^k taxels: 2^⌊k/2⌋ and 2^⌈k/2⌉."""
    if taxels < 1 or taxels & (taxels - 1):
        raise InputError(f"expected patches of a power of two taxels, got {taxels}")
    high = 1 << (taxels.bit_length() - 1) // 2
    return high, taxels // high


def patches(surface: Surface, taxels: int, blocks: Sequence[int], gaps: Indices) -> list[Indices]:
    """Deal patches out to buses, so that a touch meets all buses alike.

    Parameters
    ----------
    surface : Surface
        Of the skin. Where it is no grid, or its sides are no multiples of a patch's height and width, `neighbours`
        makes patches of other shapes.
    taxels : int
        Of one patch.
    blocks : sequence of int
        How many patches each bus takes, in all those of the skin. Of four equal buses, the patch beside one is two
        buses further, the patch below one.
    gaps : array of int
        Taxels that a grid lacks, row-major: no patch has them.

    Returns
    -------
    list of arrays of int, shape (blocks of the bus, taxels)
        Taxels, by bus: those of each patch, row by row; the patches row by row. From n on: empty places.
    """
    high, wide = patch_shape(taxels)
    rows, columns = surface.shape
    count = rows * columns
    there = np.delete(np.arange(count), gaps)
    if not sum(blocks) - 1 < there.size / taxels <= sum(blocks):
        raise InputError(f"{sum(blocks)} patches of {taxels} taxels do not fit a skin of {there.size} taxels")
    if not surface.is_grid or rows % high or columns % wide or gaps.size:
        # In pitches and rounded: ties are ties, whatever the last bits.
        positions = np.round(surface.positions_m[there, ::-1] / surface.pitch_m, 6)
        places = neighbours(positions, sum(blocks), taxels, surface.islands[there])
        flat = np.append(there, np.arange(count, count + places.size - there.size))[places]
        bus_of = _dealt(np.arange(len(flat)) % len(blocks), blocks)
        return [flat[bus_of == bus] for bus in range(len(blocks))]
    cells = np.arange(count).reshape(rows // high, high, columns // wide, wide).swapaxes(1, 2)
    down, across = np.indices(cells.shape[:2])
    buses = len(blocks)
    bus_of = _dealt(((down + max(1, buses // 2) * across) % buses).ravel(), blocks)
    flat = cells.reshape(-1, taxels)
    return [flat[bus_of == bus] for bus in range(buses)]


def neighbours(positions: npt.NDArray[np.number], blocks: int, taxels: int, islands: Indices | None = None) -> Indices:
    """Divide taxels at any positions into patches of neighbours, and order each as if it were a rectangle.

    The taxels are halved until each patch has as many as the others, to one taxel: between islands where both halves
    then fit their patches, else across their longest extent. A patch is halved on: the halves of its taxels become
    the halves of a rectangle of `patch_shape`. So the rows of low sequency (`grouped_rows`) are sums of neighbours in
    a patch of any shape.

    Parameters
    ----------
    positions : array, shape (n, axes)
    blocks : int
        Number of patches, with room for all taxels.
    taxels : int
        Places of a patch, a power of two.
    islands : array of int, shape (n,), optional
        Number of each taxel's island, of taxels that are apart from all others; without it all are one.

    Returns
    -------
    array of int, shape (blocks, taxels)
        Taxels of each patch, row by row of its rectangle; from n on: empty places, which lie together.
    """
    count = len(positions)
    apart = np.zeros(count, np.intp) if islands is None else islands

    def evenly(members: Indices, first: int, parts: int) -> tuple[Indices, int]:
        fits = range(members.size - (parts - first) * taxels, first * taxels + 1)
        ordered, cut = _along(positions, members), members.size * first // parts
        return _between(positions, members, apart, fits, cut) or (ordered, cut)

    def full_first(members: Indices, first: int, _parts: int) -> tuple[Indices, int]:
        return _along(positions, members), min(members.size, first)  # so that empty places lie together

    found = np.full((blocks, taxels), -1, np.intp)
    for chain, patch in zip(_halved(np.arange(count), blocks, evenly), found, strict=True):
        places = _halved(chain, taxels, full_first)
        patch[_rectangle(taxels)] = [place[0] if place.size else -1 for place in places]
    empty = found < 0
    found[empty] = np.arange(count, found.size)
    return found


def _halved(members: Indices, parts: int, divide: Callable[[Indices, int, int], tuple[Indices, int]]) -> list[Indices]:
    """Halve taxels into `parts`; `divide` orders them, and tells how many go to the first of all parts."""
    if parts == 1:
        return [members]
    first = parts // 2
    ordered, cut = divide(members, first, parts)
    return [*_halved(ordered[:cut], first, divide), *_halved(ordered[cut:], parts - first, divide)]


def _along(positions: npt.NDArray[np.number], members: Indices) -> Indices:
    """Sort taxels along their longest extent."""
    if not members.size:
        return members
    axis = int(np.ptp(positions[members], axis=0).argmax())
    return members[np.argsort(positions[members, axis], kind="stable")]


def _between(
    positions: npt.NDArray[np.number], members: Indices, islands: Indices, fits: range, wanted: int
) -> tuple[Indices, int] | None:
    """Sort taxels island by island, along the axis where a cut between islands that `fits` is nearest to `wanted`."""
    names, of_members, sizes = np.unique(islands[members], return_inverse=True, return_counts=True)
    best = None
    for axis in range(positions.shape[1] if names.size > 1 else 0):
        centre = np.bincount(of_members, positions[members, axis]) / sizes
        order = np.argsort(centre, kind="stable")
        for cut in np.cumsum(sizes[order])[:-1].tolist():
            if cut in fits and (best is None or abs(cut - wanted) < abs(best[1] - wanted)):
                best = members[np.argsort(np.argsort(order)[of_members], kind="stable")], cut
    return best


@cache
def _rectangle(taxels: int) -> Indices:
    """Return the places, row by row, of a rectangle of `patch_shape` in the order of its halves of halves."""
    high, wide = patch_shape(taxels)
    parts = [np.arange(taxels).reshape(high, wide)]
    while parts[0].size > 1:
        axis = 1 if parts[0].shape[1] > parts[0].shape[0] else 0
        parts = [half for part in parts for half in np.split(part, 2, axis=axis)]
    return np.concatenate([part.ravel() for part in parts])


def _dealt(wanted: Indices, blocks: Sequence[int]) -> Indices:
    """Return the bus of every block: the `wanted` bus, or the next that has room; `blocks` counts those of a bus."""
    left, bus_of, buses = list(blocks), np.empty(wanted.size, np.intp), len(blocks)
    for place, first in enumerate(wanted.tolist()):
        bus = next(each % buses for each in range(first, first + buses) if left[each % buses])
        left[bus] -= 1
        bus_of[place] = bus
    return bus_of


@cache
def grouped_rows(taxels: int) -> Indices:
    """Return the rows of the Sylvester-ordered Hadamard matrix of a patch, group by group.

    Parameters
    ----------
    taxels : int
        Of a patch, 8 or more; the patch is read row by row.

    Returns
    -------
    array of int, shape (taxels / GROUP_ROWS, GROUP_ROWS)
        The rows of vertical sequency a and horizontal sequency b, by a, then b, are a table of the shape of the patch.
        A group is a part of 2 x 4 of this table; the groups are read row by row. The first row of group 0 is the sum of
        all taxels.
    """
    rows = _table(taxels)
    high, wide = rows.shape
    down, across = _GROUP_SHAPE
    if high < down or wide < across:
        raise InputError(f"expected patches of {GROUP_ROWS} taxels or more, got {taxels}")
    groups = rows.reshape(high // down, down, wide // across, across).swapaxes(1, 2)
    return groups.reshape(-1, GROUP_ROWS)


def coarse_rows(taxels: int) -> Indices:
    """Return the quarter of the rows with the lowest sequencies: they alone give the means of cells of 2 x 2 taxels."""
    rows = _table(taxels)
    high, wide = rows.shape
    return rows[: high // 2, : wide // 2].ravel()


def _table(taxels: int) -> Indices:
    """Return the rows of the Sylvester-ordered Hadamard matrix of a patch by vertical and horizontal sequency."""
    high, wide = patch_shape(taxels)
    return _by_sequency(high)[:, None] * wide + _by_sequency(wide)


@cache
def walsh_matrix(taxels: int) -> npt.NDArray[np.float32]:
    """Return the Walsh rows of a patch in the order of `grouped_rows`, ±1, shape (taxels, taxels)."""
    return _hadamard(taxels)[grouped_rows(taxels).ravel()].astype(np.float32)


@cache
def haar_matrix(taxels: int) -> npt.NDArray[np.float32]:
    """Return the orthonormal Haar pyramid of a patch, coarse rows first, shape (taxels, taxels).

    A patch that is twice as wide as high is first halved across; every square is then quartered, down to taxels.
    """
    high, wide = patch_shape(taxels)
    rows = [np.ones((high, wide))]
    if wide > high:
        rows.append(np.ones((high, wide)))
        rows[-1][:, high:] = -1
    size = high
    while size > 1:
        half = size // 2
        signs = np.ones(size)
        signs[half:] = -1
        for shape in (np.outer(signs, np.ones(size)), np.outer(np.ones(size), signs), np.outer(signs, signs)):
            for down in range(0, high, size):
                for across in range(0, wide, size):
                    row = np.zeros((high, wide))
                    row[down : down + size, across : across + size] = shape
                    rows.append(row)
        size = half
    flat = np.stack([row.ravel() / np.linalg.norm(row) for row in rows])
    return flat.astype(np.float32)


def _by_sequency(size: int) -> Indices:
    """Return the rows of the Sylvester-ordered Hadamard matrix by their number of sign changes."""
    changes = (np.diff(_hadamard(size), axis=1) != 0).sum(axis=1)
    return np.argsort(changes, kind="stable").astype(np.intp)


def _hadamard(size: int) -> npt.NDArray[np.int64]:
    """Return the Sylvester-ordered Hadamard matrix."""
    return np.asarray(fast_hadamard(np.eye(size, dtype=np.int64)), np.int64)
