"""Differences of neighbouring taxels D x, and their adjoint Dᵀ u, for compiled code.

A full grid has loops of its own. On any other skin, edges are sorted so that long runs of them join taxels that follow
each other: the compiler vectorises the loop over a run, because unsigned indices never count from the end. The other
edges are taken one by one.
"""

from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from reconstructor.kernels.transforms import FAST_MATH, Flat
from shell.compiled import njit
from skin.surface import grid_surface

Indices = npt.NDArray[np.intp]
#: Edges of a shorter run are taken one by one.
SHORTEST_RUN: Final = 8
#: Elements between the rows of working memory; without this gap all rows use the same sets of the L1 cache.
GAP: Final = 144


class Graph(NamedTuple):
    """The edges of a skin. The dual u has one element for each edge, and `size` with those that are not used.

    Attributes
    ----------
    is_grid : bool
        Whether it is a full grid; the dual then has the differences downwards, and from `second` on those to the right.
    columns, second : int
        Of a grid.
    runs : array of uint64, shape (4, runs)
        Lower taxel, higher taxel and number of the first edge, and length.
    singles : array of uint64, shape (3, singles)
        Lower taxel, higher taxel and number of each edge that is in no run.
    size : int
    bound : int
        Of ‖D Dᵀ‖: most edges at the two ends of one edge (Anderson and Morley 1985).
    """

    is_grid: bool
    columns: int
    second: int
    runs: npt.NDArray[np.uint64]
    singles: npt.NDArray[np.uint64]
    size: int
    bound: int


def graph_of(rows: int, columns: int, gaps: Indices, edges: Indices | None) -> Graph:
    """Return the graph of a grid with its gaps, or of as many taxels with `edges` of shape (edges, 2)."""
    is_grid = edges is None and not gaps.size
    if edges is None:
        edges = grid_surface(rows, columns, 1.0, gaps).edges
    low, high, starts, lengths = _stretches(edges)
    is_long = lengths >= SHORTEST_RUN
    kept = np.repeat(is_long, lengths)
    numbers = np.cumsum(lengths[is_long]) - lengths[is_long]
    starts = starts[is_long]
    second = rows * columns + GAP
    degree = np.bincount(edges.ravel(), minlength=rows * columns)
    return Graph(
        is_grid=is_grid,
        columns=columns,
        second=second,
        runs=np.stack((low[starts], high[starts], numbers, lengths[is_long])).astype(np.uint64),
        singles=np.stack((low[~kept], high[~kept], np.arange(kept.sum(), kept.size))).astype(np.uint64),
        size=second + rows * columns if is_grid else low.size,
        bound=8 if is_grid else int(degree[edges].sum(axis=1).max(initial=2)),
    )


def _stretches(edges: Indices) -> tuple[Indices, Indices, Indices, Indices]:
    """Sort edges; return their lower and higher taxels, and where stretches begin that are runs, and their lengths."""
    low, high = np.sort(edges, axis=1).T
    order = np.lexsort((low, high - low))
    low, high = low[order], high[order]
    is_first = np.append(True, (np.diff(low) != 1) | (np.diff(high) != 1))[: low.size]
    starts = np.flatnonzero(is_first)
    return low, high, starts, np.diff(np.append(starts, low.size))


def in_runs(edges: Indices, taxels: int) -> Indices:
    """Return a place of each taxel, so that edges are in few runs: its number, or that of reverse Cuthill and McKee."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import reverse_cuthill_mckee

    ends = np.concatenate((edges, edges[:, ::-1])).T
    joined = coo_array((np.ones(ends.shape[1], np.int8), (ends[0], ends[1])), shape=(taxels, taxels)).tocsr()
    places = np.arange(taxels), np.argsort(reverse_cuthill_mckee(joined, symmetric_mode=True))
    return min(places, key=lambda place: _stretches(place[edges])[3].size)


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def smooth(image: Flat, made: Flat, dual: Flat, graph: Graph, floor: Any) -> None:
    """Set made = max(floor, image - Dᵀ dual)."""
    if graph.is_grid:
        down, right = dual[: image.size], dual[graph.second : graph.second + image.size]
        _smooth_grid(image, made, (down, right), graph.columns, floor)
        return
    for k in range(made.size):
        made[k] = image[k]
    low, high, first, length = graph.runs
    for run in range(low.size):
        a, b, c = low[run], high[run], first[run]
        for k in range(length[run]):
            made[a + k] += dual[c + k]
        for k in range(length[run]):
            made[b + k] -= dual[c + k]
    low, high, first = graph.singles
    for k in range(low.size):
        made[low[k]] += dual[first[k]]
        made[high[k]] -= dual[first[k]]
    for k in range(made.size):
        made[k] = max(floor, made[k])


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def ascend(made: Flat, dual: Flat, graph: Graph, threshold: Any, step: Any) -> None:
    """Add D `made` x `step` to the dual, and clip the dual to ±threshold."""
    if graph.is_grid:
        down, right = dual[: made.size], dual[graph.second : graph.second + made.size]
        _ascend_grid(made, (down, right), graph.columns, threshold, step)
        return
    low, high, first, length = graph.runs
    for run in range(low.size):
        a, b, c = low[run], high[run], first[run]
        for k in range(length[run]):
            dual[c + k] = max(-threshold, min(threshold, dual[c + k] + step * (made[b + k] - made[a + k])))
    low, high, first = graph.singles
    for k in range(low.size):
        slope = made[high[k]] - made[low[k]]
        dual[first[k]] = max(-threshold, min(threshold, dual[first[k]] + step * slope))


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def laplacian(values: Flat, made: Flat, graph: Graph) -> None:
    """Set made = DᵀD values: each taxel's differences from its neighbours, summed."""
    for k in range(made.size):
        made[k] = 0
    low, high, _, length = graph.runs
    for run in range(low.size):
        a, b = low[run], high[run]
        for k in range(length[run]):
            made[a + k] += values[a + k] - values[b + k]
        for k in range(length[run]):
            made[b + k] += values[b + k] - values[a + k]
    low, high, _ = graph.singles
    for k in range(low.size):
        slope = values[low[k]] - values[high[k]]
        made[low[k]] += slope
        made[high[k]] -= slope


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _smooth_grid(image: Flat, made: Flat, dual: tuple[Flat, Flat], columns: int, floor: Any) -> None:
    """See `smooth`; the dual is 0 after the last row and the last column.

    Slices, because the compiler does not vectorise indices that might be negative.
    """
    down, right = dual
    made[0] = max(floor, image[0] + down[0] + right[0])
    out, seen, below, beside = made[1:columns], image[1:], down[1:], right[1:]
    for k in range(out.size):
        out[k] = max(floor, seen[k] + below[k] + beside[k] - right[k])
    out, seen, below, beside = made[columns:], image[columns:], down[columns:], right[columns:]
    before = right[columns - 1 :]
    for k in range(out.size):
        out[k] = max(floor, seen[k] + below[k] - down[k] + beside[k] - before[k])


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _ascend_grid(made: Flat, dual: tuple[Flat, Flat], columns: int, threshold: Any, step: Any) -> None:
    down, right = dual
    below, beside = made[columns:], made[1:]
    for k in range(made.size - columns):
        down[k] = max(-threshold, min(threshold, down[k] + step * (below[k] - made[k])))
    for k in range(made.size - 1):
        right[k] = max(-threshold, min(threshold, right[k] + step * (beside[k] - made[k])))
    for k in range(columns - 1, made.size, columns):
        right[k] = 0
