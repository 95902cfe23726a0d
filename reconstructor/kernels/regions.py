"""Connected regions of an image, and to which earlier regions their taxels belong."""

import heapq
from typing import Any, Final

import numpy as np

from shell.compiled import njit

#: Columns of the table of `measure_parts`: sums of the force, of force x row and of force x column, largest force,
#: number of taxels, first and last row, first and last column; the highest pass to another part of the region (the
#: lower of the two taxels where the parts touch), and the number of that part.
FORCE: Final = 0
BY_ROW: Final = 1
BY_COLUMN: Final = 2
PEAK: Final = 3
AREA: Final = 4
TOP: Final = 5
BOTTOM: Final = 6
LEFT: Final = 7
RIGHT: Final = 8
PASS: Final = 9
NEIGHBOUR: Final = 10
FEATURES: Final = 11
#: Distance in taxels within which the border between two contacts can move from image to image.
BORDER: Final = 2


@njit(cache=True, nogil=True)
def find_regions(image: Any, edge: float, least_peak: float, regions: Any, queue: Any) -> int:
    """Give numbers to the regions of taxels above `edge`, neighbours in eight directions, from 1; return the last.

    Parameters
    ----------
    image : array of float, shape (rows, columns)
    least_peak : float
        A region without a taxel above this is left out.
    regions : array of int32, shape (rows, columns)
        Set to the number of each taxel's region; 0 is none.
    queue : array of int32, shape (rows * columns,)
        Scratch.
    """
    rows, columns = image.shape
    regions[:] = 0
    number, force = regions.ravel(), image.ravel()
    count, weak = 0, -1
    for start in range(rows * columns):
        if number[start] or not force[start] > edge:
            continue
        number[start] = weak
        queue[0], first, last = start, 0, 1
        peak = force[start]
        while first < last:
            row, column = divmod(queue[first], columns)
            peak = max(peak, force[queue[first]])
            first += 1
            for y in range(max(row - 1, 0), min(row + 2, rows)):
                for x in range(max(column - 1, 0), min(column + 2, columns)):
                    if not regions[y, x] and image[y, x] > edge:
                        regions[y, x] = weak
                        queue[last] = y * columns + x
                        last += 1
        if peak > least_peak:
            count += 1
            for place in range(last):
                number[queue[place]] = count
    for start in range(rows * columns):
        number[start] = max(number[start], 0)
    return count


@njit(cache=True, nogil=True)
def spread_owners(image: Any, regions: Any, owners: Any, seeds: Any) -> None:
    """Give each taxel of a region an owner: the one it had, else that of the taxels uphill of it.

    Where two owners meet, the border between them follows the valley: taxels within `BORDER` of another owner are given
    anew. Owners spread from their other taxels to neighbours in eight directions, over the largest force first.

    Parameters
    ----------
    image : array of float, shape (rows, columns)
    regions : array of int32, shape (rows, columns)
        From `find_regions`.
    owners : array of int32, shape (rows, columns)
        Numbers of the owners, from 1. Set to 0 outside of regions, and spread inside. A region without owner keeps 0.
    seeds : array of int32, shape (rows, columns)
        Scratch.
    """
    rows, columns = regions.shape
    _plant(regions, owners, seeds)
    heap = [(0.0, 0)]
    heap.pop()
    owners[:] = seeds
    for y in range(rows):
        for x in range(columns):
            if seeds[y, x] and _can_spread(regions, owners, y, x):
                heap.append((-np.float64(image[y, x]), y * columns + x))  # noqa: PERF401  no generators here
    heapq.heapify(heap)
    while heap:
        row, column = divmod(heapq.heappop(heap)[1], columns)
        for y in range(max(row - 1, 0), min(row + 2, rows)):
            for x in range(max(column - 1, 0), min(column + 2, columns)):
                if regions[y, x] and not owners[y, x]:
                    owners[y, x] = owners[row, column]
                    heapq.heappush(heap, (-np.float64(image[y, x]), y * columns + x))


@njit(cache=True, nogil=True)
def _can_spread(regions: Any, owners: Any, row: int, column: int) -> bool:
    """Tell whether a neighbour of the region has no owner."""
    rows, columns = regions.shape
    for y in range(max(row - 1, 0), min(row + 2, rows)):
        for x in range(max(column - 1, 0), min(column + 2, columns)):
            if regions[y, x] and not owners[y, x]:
                return True
    return False


@njit(cache=True, nogil=True)
def _plant(regions: Any, owners: Any, seeds: Any) -> None:
    """Set the seeds: owners inside of regions, without taxels at a border unless an owner has no others."""
    rows, columns = regions.shape
    inner = np.zeros(owners.max() + 1, np.bool_)
    for y in range(rows):
        for x in range(columns):
            if not regions[y, x]:
                owners[y, x] = 0
    for y in range(rows):
        for x in range(columns):
            is_inner = owners[y, x] > 0 and not _is_border(owners, y, x)
            seeds[y, x] = owners[y, x] if is_inner else 0
            if is_inner:
                inner[owners[y, x]] = True
    for y in range(rows):
        for x in range(columns):
            if not inner[owners[y, x]]:
                seeds[y, x] = owners[y, x]


@njit(cache=True, nogil=True)
def _is_border(owners: Any, row: int, column: int) -> bool:
    """Tell whether another owner is near."""
    rows, columns = owners.shape
    for y in range(max(row - BORDER, 0), min(row + BORDER + 1, rows)):
        for x in range(max(column - BORDER, 0), min(column + BORDER + 1, columns)):
            if owners[y, x] and owners[y, x] != owners[row, column]:
                return True
    return False


@njit(cache=True, nogil=True)
def number_parts(regions: Any, owners: Any, parts: Any, table: Any) -> int:
    """Give numbers to the pairs of region and owner, from 1; return the last.

    Parameters
    ----------
    regions, owners : array of int32, shape (rows, columns)
    parts : array of int32, shape (rows, columns)
        Set to the number of each taxel's pair; 0 outside of regions.
    table : array of int32, shape (rows * columns, 2)
        Row k - 1 is set to region and owner of part k.
    """
    count = 0
    rows, columns = regions.shape
    for y in range(rows):
        for x in range(columns):
            parts[y, x] = 0
            if not regions[y, x]:
                continue
            for known in range(count):
                if table[known, 0] == regions[y, x] and table[known, 1] == owners[y, x]:
                    parts[y, x] = known + 1
                    break
            else:
                table[count, 0], table[count, 1] = regions[y, x], owners[y, x]
                count += 1
                parts[y, x] = count
    return count


@njit(cache=True, nogil=True)
def measure_parts(image: Any, parts: Any, table: Any) -> None:
    """Sum up each part, and find its highest pass to a neighbouring part.

    Parameters
    ----------
    image : array of float, shape (rows, columns)
    parts : array of int32, shape (rows, columns)
        Numbers from 1; 0 is left out.
    table : array of float64, shape (parts, FEATURES)
        Set to one row for each part.
    """
    rows, columns = image.shape
    table[:] = 0
    table[:, TOP], table[:, LEFT] = rows, columns
    for y in range(rows):
        for x in range(columns):
            if not parts[y, x]:
                continue
            part, force = table[parts[y, x] - 1], image[y, x]
            part[FORCE] += force
            part[BY_ROW] += force * y
            part[BY_COLUMN] += force * x
            part[PEAK] = max(part[PEAK], force)
            part[AREA] += 1
            part[TOP], part[BOTTOM] = min(part[TOP], y), max(part[BOTTOM], y)
            part[LEFT], part[RIGHT] = min(part[LEFT], x), max(part[RIGHT], x)
            for v in range(max(y - 1, 0), min(y + 2, rows)):
                for u in range(max(x - 1, 0), min(x + 2, columns)):
                    if parts[v, u] and parts[v, u] != parts[y, x] and min(force, image[v, u]) > part[PASS]:
                        part[PASS], part[NEIGHBOUR] = min(force, image[v, u]), parts[v, u]
