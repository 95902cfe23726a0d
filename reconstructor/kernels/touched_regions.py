"""Connected regions of an image, and to which earlier regions their taxels belong.

Which taxels are neighbours is a table, shape (n, K), of which a row has the neighbours of a taxel in ascending order; a
taxel with fewer of them names itself in what is left.
"""

import heapq
from functools import cache
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from shell.compiled import njit
from skin.surface import Surface

#: Columns of the table of `measure_parts`: sum of the force, largest force, number of taxels, first and last row, first
#: and last column; the highest pass to another part of the region (the lower of the two taxels where the parts touch),
#: and the number of that part. Sums of the force x the places of the taxels follow.
FORCE: Final = 0
PEAK: Final = 1
AREA: Final = 2
TOP: Final = 3
BOTTOM: Final = 4
LEFT: Final = 5
RIGHT: Final = 6
PASS: Final = 7
NEIGHBOUR: Final = 8
FEATURES: Final = 9
#: Steps from taxel to taxel within which the border between two contacts can move from image to image.
BORDER: Final = 2
#: Taxels with a neighbour in common are neighbours, too, up to this multiple of the pitch: the diagonal of a square.
DIAGONAL_RATIO: Final = 1.5


@cache
def neighbour_tables(surface: Surface) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]:
    """Return the tables of the taxels within one step and within `BORDER` steps of each taxel of a skin.

    A step leads along an edge, or to a taxel with a common neighbour at most `DIAGONAL_RATIO` times the pitch away: so
    on a grid in eight directions, and never across a gap.
    """
    edges = np.concatenate((surface.edges, surface.edges[:, ::-1]))
    along = _table(edges, len(surface.positions_m))
    near = _two_steps(along, along)
    apart_m = np.linalg.norm(np.subtract(*surface.positions_m[near.T]), axis=1)
    step = _table(np.concatenate((edges, near[apart_m <= DIAGONAL_RATIO * surface.pitch_m])), len(along))
    within = step
    for _ in range(BORDER - 1):
        within = _table(_two_steps(within, step), len(step))
    return step, within


def _two_steps(first: npt.NDArray[np.int32], second: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
    """Return pairs of taxels, shape (count, 2), that two steps or one lead to: a table names the taxel itself, too."""
    other = second[first].reshape(len(first), -1)
    return np.stack((np.repeat(np.arange(len(first), dtype=np.int32), other.shape[1]), other.ravel()), axis=1)


def _table(pairs: npt.NDArray[np.integer], count: int) -> npt.NDArray[np.int32]:
    """Return the table of pairs of `count` taxels, without those of a taxel and itself."""
    taxel, other = pairs[pairs[:, 0] != pairs[:, 1]].astype(np.int64).T
    places = np.sort(taxel * count + other)  # np.unique takes 20 times as long
    taxel, other = np.divmod(places[np.diff(places, prepend=-1) > 0], count)
    degrees = np.bincount(taxel, minlength=count)
    table = np.repeat(np.arange(len(degrees), dtype=np.int32)[:, None], degrees.max(initial=1), axis=1)
    table[taxel, np.arange(len(taxel)) - np.repeat(np.cumsum(degrees) - degrees, degrees)] = other
    return table


@njit(cache=True, nogil=True)
def find_regions(  # noqa: PLR0917 - compiled
    force: Any, neighbours: Any, edge: float, least_peak: float, regions: Any, queue: Any
) -> int:
    """Give numbers to the regions of neighbouring taxels above `edge`, from 1; return the last.

    Parameters
    ----------
    force : array of float, shape (n,)
    least_peak : float
        A region without a taxel above this is left out.
    regions : array of int32, shape (n,)
        Set to the number of each taxel's region; 0 is none.
    queue : array of int32, shape (n,)
        Scratch.
    """
    regions[:] = 0
    count, weak = 0, -1
    for start in range(force.size):
        if regions[start] or not force[start] > edge:
            continue
        regions[start] = weak
        queue[0], first, last = start, 0, 1
        peak = force[start]
        while first < last:
            taxel = queue[first]
            peak = max(peak, force[taxel])
            first += 1
            for other in neighbours[taxel]:
                if not regions[other] and force[other] > edge:
                    regions[other] = weak
                    queue[last] = other
                    last += 1
        if peak > least_peak:
            count += 1
            for place in range(last):
                regions[queue[place]] = count
    for start in range(force.size):
        regions[start] = max(regions[start], 0)
    return count


@njit(cache=True, nogil=True)
def spread_owners(  # noqa: PLR0917 - compiled
    force: Any, neighbours: Any, around: Any, regions: Any, owners: Any, seeds: Any
) -> None:
    """Give each taxel of a region an owner: the one it had, else that of the taxels uphill of it.

    Where two owners meet, the border between them follows the valley: taxels within `BORDER` of another owner are given
    anew. Owners spread from their other taxels to their neighbours, over the largest force first.

    Parameters
    ----------
    force : array of float, shape (n,)
    neighbours, around : array of int32
        Tables of the taxels within one step, and within `BORDER`.
    regions : array of int32, shape (n,)
        From `find_regions`.
    owners : array of int32, shape (n,)
        Numbers of the owners, from 1. Set to 0 outside of regions, and spread inside. A region without owner keeps 0.
    seeds : array of int32, shape (n,)
        Scratch.
    """
    _plant(around, regions, owners, seeds)
    heap = [(0.0, 0)]
    heap.pop()
    owners[:] = seeds
    for taxel in range(force.size):
        if seeds[taxel] and _can_spread(neighbours[taxel], regions, owners):
            heap.append((-np.float64(force[taxel]), taxel))  # noqa: PERF401  no generators here
    heapq.heapify(heap)
    while heap:
        taxel = heapq.heappop(heap)[1]
        for other in neighbours[taxel]:
            if regions[other] and not owners[other]:
                owners[other] = owners[taxel]
                heapq.heappush(heap, (-np.float64(force[other]), 0 + other))  # of the type of the others


@njit(cache=True, nogil=True)
def _can_spread(neighbours: Any, regions: Any, owners: Any) -> bool:
    """Tell whether a neighbour of the region has no owner."""
    for other in neighbours:  # noqa: SIM110  no generators here
        if regions[other] and not owners[other]:
            return True
    return False


@njit(cache=True, nogil=True)
def _plant(around: Any, regions: Any, owners: Any, seeds: Any) -> None:
    """Set the seeds: owners inside of regions, without taxels at a border unless an owner has no others."""
    inner = np.zeros(owners.max() + 1, np.bool_)
    for taxel in range(owners.size):
        if not regions[taxel]:
            owners[taxel] = 0
    for taxel in range(owners.size):
        is_inner = owners[taxel] > 0 and not _is_border(around[taxel], owners, owners[taxel])
        seeds[taxel] = owners[taxel] if is_inner else 0
        if is_inner:
            inner[owners[taxel]] = True
    for taxel in range(owners.size):
        if not inner[owners[taxel]]:
            seeds[taxel] = owners[taxel]


@njit(cache=True, nogil=True)
def _is_border(around: Any, owners: Any, mine: int) -> bool:
    """Tell whether another owner is near."""
    for other in around:  # noqa: SIM110  no generators here
        if owners[other] and owners[other] != mine:
            return True
    return False


@njit(cache=True, nogil=True)
def number_parts(regions: Any, owners: Any, parts: Any, table: Any) -> int:
    """Give numbers to the pairs of region and owner, from 1; return the last.

    Parameters
    ----------
    regions, owners : array of int32, shape (n,)
    parts : array of int32, shape (n,)
        Set to the number of each taxel's pair; 0 outside of regions.
    table : array of int32, shape (n, 2)
        Row k - 1 is set to region and owner of part k.
    """
    count = 0
    for taxel in range(regions.size):
        parts[taxel] = 0
        if not regions[taxel]:
            continue
        for known in range(count):
            if table[known, 0] == regions[taxel] and table[known, 1] == owners[taxel]:
                parts[taxel] = known + 1
                break
        else:
            table[count, 0], table[count, 1] = regions[taxel], owners[taxel]
            count += 1
            parts[taxel] = count
    return count


@njit(cache=True, nogil=True)
def measure_parts(image: Any, neighbours: Any, places: Any, parts: Any, table: Any) -> None:
    """Sum up each part, and find its highest pass to a neighbouring part.

    Parameters
    ----------
    image : array of float, shape (rows, columns)
    places : array of float64, shape (n, D)
        Where each taxel is.
    parts : array of int32, shape (n,)
        Numbers from 1; 0 is left out.
    table : array of float64, shape (parts, FEATURES + D)
        Set to one row for each part.
    """
    rows, columns = image.shape
    forces = image.ravel()
    table[:] = 0
    table[:, TOP], table[:, LEFT] = rows, columns
    for taxel in range(forces.size):
        if not parts[taxel]:
            continue
        part, force = table[parts[taxel] - 1], forces[taxel]
        y, x = divmod(taxel, columns)
        part[FORCE] += force
        part[PEAK] = max(part[PEAK], force)
        part[AREA] += 1
        part[TOP], part[BOTTOM] = min(part[TOP], y), max(part[BOTTOM], y)
        part[LEFT], part[RIGHT] = min(part[LEFT], x), max(part[RIGHT], x)
        for each in range(places.shape[1]):
            part[FEATURES + each] += force * places[taxel, each]
        for other in neighbours[taxel]:
            if parts[other] and parts[other] != parts[taxel] and min(force, forces[other]) > part[PASS]:
                part[PASS], part[NEIGHBOUR] = min(force, forces[other]), parts[other]
