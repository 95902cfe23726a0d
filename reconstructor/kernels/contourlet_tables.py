"""Tables for the compiled contourlet: the order of its samples in memory.

A filter along one direction is a loop over contiguous memory if this direction changes slowest: a step of t samples is
then a step of t rows. Therefore the first half of every level is stored as (columns, rows, bands) and the second as
(rows, bands, columns). Each ladder step filters one direction, transposes, and filters the other direction. The
permutations between the levels include these orders at no extra cost. The image has its even rows and columns before
the odd ones, as the filters of the pyramid need.
"""

from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from reconstructor.bases.contourlet import Contourlet
from reconstructor.bases.directional import Level
from reconstructor.bases.pkva import FAN
from reconstructor.kernels.steps import Table, aligned
from reconstructor.kernels.transforms import Flat

Taps = npt.NDArray[np.float64]
TAPS: Final = 12


class Phases(NamedTuple):
    """Taps of one pyramid filter for even and odd samples, each a multiple of four.

    Attributes
    ----------
    even, odd : shape (taps,)
    before : shape (2,)
        Number of samples before the middle sample, of even and odd taps.
    """

    even: Flat
    odd: Flat
    before: npt.NDArray[np.int64]


class ContourletTables(NamedTuple):
    """The transform of one size.

    Attributes
    ----------
    low, high : Phases
        The pyramid's filters for analysis and synthesis.
    gathers, returns : shape (levels, n)
        Permutations before each level's ladder, and their inverses.
    turns : shape (levels, 2, n / 2)
        Permutations from the order of the first half to that of the second, and back.
    flips : shape (2, n / 2)
        Transposes of (rows / 2, columns) and of (columns, rows / 2).
    geometry : shape (levels, 4)
        Bands, rows, columns, and taps along the rows' direction.
    across : shape (12,)
    along : shape (levels, 2, 12)
        Taps of F and of its transpose, folded for bands with fewer than 12 rows.
    size : int
        Rows of the image.
    """

    low: Phases
    high: Phases
    gathers: Table
    returns: Table
    turns: npt.NDArray[np.uint16]
    flips: Table
    geometry: npt.NDArray[np.int64]
    across: Flat
    along: npt.NDArray[np.floating[Any]]
    size: int


class ContourletBuffers(NamedTuple):
    """Working memory: two images, a half image, and two buffers for filters."""

    image: Flat
    other: Flat
    half: Flat
    long: Flat
    wide: Flat


def make_tables(psi: Contourlet, dtype: np.dtype[Any]) -> ContourletTables:
    """Return the tables of a contourlet."""
    levels, size = psi.levels, psi.image_shape[0]
    places = [np.argsort(image_order(size)), *(_places(level) for level in levels)]
    gathers = np.empty((len(levels), size * size), np.uint16)
    for number, level in enumerate(levels):
        gathers[number, places[number + 1]] = places[number][level.gather]
    halves = np.arange(size * size // 2)
    flip = halves.reshape(size // 2, size)
    return ContourletTables(
        low=_phases(psi.pair.down[0], dtype),
        high=_phases(psi.pair.up[:, 0], dtype),
        gathers=gathers,
        returns=np.argsort(gathers, axis=1).astype(np.uint16),
        turns=np.stack([_turns(level) for level in levels]),
        flips=np.stack((flip.T.ravel(), flip.reshape(size, size // 2).T.ravel())).astype(np.uint16),
        geometry=np.array([(each.bands, each.rows, each.columns, _tap_count(each)) for each in levels]),
        across=FAN[::-1].astype(dtype),
        along=np.stack([[_folded(level, before) for before in (5, 6)] for level in levels]).astype(dtype),
        size=size,
    )


def image_order(size: int) -> npt.NDArray[np.intp]:
    """Return the row-major pixel at each place of the stored image: even rows and columns first."""
    split = np.concatenate((np.arange(0, size, 2), np.arange(1, size, 2)))
    return (split[:, None] * size + split[None, :]).ravel()


def coefficient_order(psi: Contourlet) -> npt.NDArray[np.intp]:
    """Return the place of each of the toolbox's coefficients; the coarse image is stored transposed."""
    coarse = np.arange(psi.order.size // 4).reshape(psi.image_shape[0] // 2, -1).T.ravel()
    return np.concatenate((coarse, coarse.size + _places(psi.levels[-1])[psi.order]))


def make_buffers(tables: ContourletTables, dtype: np.dtype[Any]) -> ContourletBuffers:
    """Return working memory for the tables of one size."""
    count = tables.size * tables.size
    longest = max(int(bands * (rows + TAPS) * columns) for bands, rows, columns, _ in tables.geometry)
    widest = max(int(bands * rows * (columns + TAPS)) for bands, rows, columns, _ in tables.geometry)
    reach = count // 2 + tables.size * max(each.size for each in (tables.low.even, tables.high.even, tables.high.odd))
    return ContourletBuffers(
        *(aligned(size, dtype) for size in (count, count, count // 2, max(longest, reach), max(widest, reach)))
    )


def _places(level: Level) -> npt.NDArray[np.intp]:
    """Return the place of each sample of the order (half, bands, rows, columns)."""
    bands, rows, columns = level.bands, level.rows, level.columns
    k, i, j = np.indices((bands, rows, columns))
    first = (j * rows + i) * bands + k
    second = first.size + (i * bands + k) * columns + j
    return np.concatenate((first.ravel(), second.ravel()))


def _turns(level: Level) -> Table:
    samples = np.arange(level.bands * level.rows * level.columns)
    there = samples.reshape(level.columns, -1).T.ravel()
    return np.stack((there, np.argsort(there))).astype(np.uint16)


def _tap_count(level: Level) -> int:
    return TAPS if level.quincunx or level.rows >= TAPS else max(4, level.rows)


def _folded(level: Level, before: int) -> Taps:
    """Return the taps along the rows' direction; folded ones start at the sample itself."""
    if _tap_count(level) == TAPS:
        return np.array(FAN[::-1])
    taps = np.zeros(TAPS)
    for t, tap in enumerate(FAN[::-1]):
        taps[(t - before) % level.rows] += tap
    return taps


def _phases(row: Taps, dtype: np.dtype[Any]) -> Phases:
    """Split a row of a periodic filter's matrix, with sample 0 in the middle, into even and odd samples."""
    size = row.size
    made, before = [], []
    for samples in (row[::2], row[1::2]):
        offsets = np.flatnonzero(samples)
        offsets = np.where(offsets >= size // 4, offsets - size // 2, offsets)
        first, last = int(offsets.min()), int(offsets.max())
        taps = np.zeros(-(-(last - first + 1) // 4) * 4)
        taps[: last - first + 1] = samples[np.arange(first, last + 1) % (size // 2)]
        made.append(taps.astype(dtype))
        before.append(-first)
    return Phases(made[0], made[1], np.array(before))
