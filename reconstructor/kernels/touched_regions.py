"""Connected regions of an image, and to which earlier regions their taxels belong.

Which taxels are neighbours is a table, shape (n, K), of which a row has the neighbours of a taxel in ascending order; a
taxel with fewer of them names itself in what is left.
"""

import heapq
from functools import cache
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from shell.compiled import borrowed, njit
from skin.surface import Surface

#: Columns of the table of `cut`: sum of the force, largest force, number of taxels, first and last row, first
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


class Regions(NamedTuple):
    """The taxels of a skin, and the regions of an image.

    Attributes
    ----------
    neighbours, around : arrays of int32
        Tables of the taxels within one step, and within `BORDER`.
    places : array of float64, shape (n, D)
        Where each taxel is.
    region, owner, part : arrays of int32, shape (n,)
        Numbers, from 1, of each taxel's region, of its owner, and of the pair of both; 0 outside of regions.
    pairs : array of int32, shape (n, 2)
        Row k - 1 is region and owner of part k.
    touched : array of int32, shape (n + 1,)
        The taxels of all regions, ascending, and -1 after the last.
    scratch : array of int32, shape (n,)
    """

    neighbours: Any
    around: Any
    places: Any
    region: Any
    owner: Any
    part: Any
    pairs: Any
    touched: Any
    scratch: Any


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


def no_regions(surface: Surface, places: npt.NDArray[np.float64]) -> Regions:
    """Return the regions of an untouched skin."""
    count = len(places)
    pairs, touched = np.zeros((count, 2), np.int32), np.full(count + 1, -1, np.int32)
    numbers, scratch = np.zeros((3, count), np.int32), np.zeros(count, np.int32)
    return Regions._make([*neighbour_tables(surface), places, *numbers, pairs, touched, scratch])


@njit(cache=True, nogil=True)
def cut(image: Any, edge: float, least_peak: float, held: Any) -> Any:
    """Cut an image, shape (rows, columns), into parts, one for each pair of region and owner; return their table.

    A region is neighbouring taxels above `edge`, one of them above `least_peak`. Each taxel of a region has the owner
    that it had, else that of the taxels uphill of it. Where two owners meet, the border between them follows the
    valley: taxels within `BORDER` of another owner are given anew. Owners spread from their other taxels to their
    neighbours, over the largest force first. A region without owner keeps 0.
    `held` are `Regions` (`shell.compiled.hold`) with the owners of the image before, and set anew. The table has shape
    (parts, FEATURES + D).
    """
    regions = borrowed(held.value)
    force = image.ravel()
    _find_regions(force, edge, least_peak, regions)
    touched = regions.touched[: _list_touched(regions)]
    _spread_owners(force, touched, regions)
    table = np.zeros((_number_parts(touched, regions), FEATURES + regions.places.shape[1]))
    _measure_parts(image, touched, regions, table)
    return table


@njit(cache=True, nogil=True)
def give_owners(  # noqa: PLR0917 - compiled
    owner_of_part: Any, image: Any, measured: Any, doubtful: Any, held: Any, table: Any
) -> None:
    """Give the taxels of each part its new owner.

    Parameters
    ----------
    owner_of_part : array of int32, shape (1 + parts,)
    measured, doubtful : arrays of bool, shape (n,)
        An empty one tells of no taxel that was not measured, or is doubtful.
    table : array of float64, shape (1 + owners, 2)
        Set to the number of taxels of each owner that were not measured, and its force on doubtful taxels.
    """
    regions = borrowed(held.value)
    force = image.ravel()
    table[:] = 0
    for taxel in regions.touched:
        if taxel < 0:
            break
        owner = owner_of_part[regions.part[taxel]]
        regions.owner[taxel] = owner
        if measured.size and not measured[taxel]:
            table[owner, 0] += 1
        if doubtful.size and doubtful[taxel]:
            table[owner, 1] += force[taxel]


@njit(cache=True, nogil=True)
def _find_regions(force: Any, edge: float, least_peak: float, regions: Regions) -> None:
    """Give numbers to the regions; taxels of one without a peak have -1."""
    region, queue = regions.region, regions.scratch
    region[:] = 0
    number, weak = 0, -1
    for start in range(force.size):
        if not force[start] > edge or region[start]:
            continue
        region[start] = weak
        queue[0], first, last = start, 0, 1
        peak = force[start]
        while first < last:
            taxel = queue[first]
            peak = max(peak, force[taxel])
            first += 1
            for other in regions.neighbours[taxel]:
                if not region[other] and force[other] > edge:
                    region[other] = weak
                    queue[last] = other
                    last += 1
        if peak > least_peak:
            number += 1
            for place in range(last):
                region[queue[place]] = number


@njit(cache=True, nogil=True)
def _list_touched(regions: Regions) -> int:
    """List the taxels of all regions, and forget owners and parts of the others; return the length of the list."""
    region, touched, count = regions.region, regions.touched, 0
    for taxel in touched:  # of the image before
        if taxel < 0:
            break
        regions.part[taxel] = 0
        if region[taxel] <= 0:
            regions.owner[taxel] = 0
    for taxel in range(region.size):
        if region[taxel] > 0:
            touched[count] = taxel
            count += 1
        elif region[taxel]:
            region[taxel] = 0
    touched[count] = -1
    return count


@njit(cache=True, nogil=True)
def _spread_owners(force: Any, touched: Any, regions: Regions) -> None:
    region, owner, seeds = regions.region, regions.owner, regions.scratch
    _plant(touched, regions.around, owner, seeds)
    heap = [(0.0, 0)]
    heap.pop()
    for taxel in touched:
        owner[taxel] = seeds[taxel]
    for taxel in touched:
        if seeds[taxel] and _can_spread(regions.neighbours[taxel], region, owner):
            heap.append((-np.float64(force[taxel]), 0 + taxel))  # noqa: PERF401  no generators here; of one type
    heapq.heapify(heap)
    while heap:
        taxel = heapq.heappop(heap)[1]
        for other in regions.neighbours[taxel]:
            if region[other] and not owner[other]:
                owner[other] = owner[taxel]
                heapq.heappush(heap, (-np.float64(force[other]), 0 + other))


@njit(cache=True, nogil=True)
def _can_spread(neighbours: Any, regions: Any, owners: Any) -> bool:
    """Tell whether a neighbour of the region has no owner."""
    for other in neighbours:  # noqa: SIM110  no generators here
        if regions[other] and not owners[other]:
            return True
    return False


@njit(cache=True, nogil=True)
def _plant(touched: Any, around: Any, owners: Any, seeds: Any) -> None:
    """Set the seeds: owners without the taxels at a border, unless an owner has no others."""
    most = 0
    for taxel in touched:
        most = max(most, owners[taxel])
    inner = np.zeros(most + 1, np.bool_)
    for taxel in touched:
        is_inner = owners[taxel] > 0 and not _is_border(around[taxel], owners, owners[taxel])
        seeds[taxel] = owners[taxel] if is_inner else 0
        if is_inner:
            inner[owners[taxel]] = True
    for taxel in touched:
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
def _number_parts(touched: Any, regions: Regions) -> int:
    """Give numbers to the pairs of region and owner, from 1; return the last."""
    count, pairs = 0, regions.pairs
    for taxel in touched:
        region, owner = regions.region[taxel], regions.owner[taxel]
        for known in range(count):
            if pairs[known, 0] == region and pairs[known, 1] == owner:
                regions.part[taxel] = known + 1
                break
        else:
            pairs[count, 0], pairs[count, 1] = region, owner
            count += 1
            regions.part[taxel] = count
    return count


@njit(cache=True, nogil=True)
def _measure_parts(image: Any, touched: Any, regions: Regions, table: Any) -> None:
    """Sum up each part in a table of zeros, and find its highest pass to a neighbouring part."""
    rows, columns = image.shape
    forces, parts, places = image.ravel(), regions.part, regions.places
    table[:, TOP], table[:, LEFT] = rows, columns
    for taxel in touched:
        part, force = table[parts[taxel] - 1], forces[taxel]
        y, x = divmod(taxel, columns)
        part[FORCE] += force
        part[PEAK] = max(part[PEAK], force)
        part[AREA] += 1
        part[TOP], part[BOTTOM] = min(part[TOP], y), max(part[BOTTOM], y)
        part[LEFT], part[RIGHT] = min(part[LEFT], x), max(part[RIGHT], x)
        for each in range(places.shape[1]):
            part[FEATURES + each] += force * places[taxel, each]
        for other in regions.neighbours[taxel]:
            if parts[other] and parts[other] != parts[taxel] and min(force, forces[other]) > part[PASS]:
                part[PASS], part[NEIGHBOUR] = min(force, forces[other]), parts[other]
