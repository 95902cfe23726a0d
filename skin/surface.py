"""Where the taxels of a skin lie in space, and which of them are neighbours.

A grid lies in the plane: its origin is the middle of the array, x runs along the columns, y down the rows, and z into
the skin, so a touch presses along z. Taxels at positions have the frame of their file. A touch presses against the
normals, which point out of the skin.

On a grid, taxels are neighbours side by side. At positions, two taxels are neighbours if they are at most `link_ratio`
times the median spacing apart, face the same side, and no third taxel of this side is in the sphere between them, whose
diameter is the line that joins them (Gabriel and Sokal 1969). So an edge is one of a Delaunay triangulation, and none
crosses a gap.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
import numpy.typing as npt

from canskin.errors import LayoutError

Floats = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

#: Neighbours are at most this times the median spacing apart, if the layout does not tell.
LINK_RATIO: Final = 1.6
#: A taxel counts as inside of a sphere up to 1.05 times its radius: so the diagonals of squares are not edges.
SPHERE_RATIO: Final = 1.05
#: Above this spacing the numbers of a file are not metres.
SPACING_MAX_M: Final = 0.25
#: Nearest taxels, one itself, that tell the spacing and the normal of a taxel.
NEAREST: Final = 7
#: At the border of a skin, neighbours around a taxel leave an angle of more than this.
BORDER_RAD: Final = np.radians(150)
#: Fewest taxels that have a second nearest one.
FEWEST: Final = 3
#: Normal of the taxels of a grid.
GRID_NORMAL: Final = (0.0, 0.0, -1.0)


@dataclass(frozen=True, eq=False)
class Surface:
    """The taxels of one skin in space.

    Attributes
    ----------
    positions_m : array, shape (n, 3)
        Metres; of gaps of a grid, too.
    normals : array, shape (n, 3)
        Of length 1, out of the skin.
    edges : array of int, shape (edges, 2)
        Pairs of neighbours, each once, the lower taxel first, in ascending order. Gaps have none.
    shape : tuple of int
        Rows and columns of the arrays of this skin; (1, n) for positions.
    is_grid : bool
        Whether the taxels are a grid, so that their forces are a picture.
    pitch_m : float
        Distance of neighbours: of the grid, or the median of the distances to the second nearest taxel.
    """

    positions_m: Floats
    normals: Floats
    edges: Indices
    shape: tuple[int, int]
    is_grid: bool
    pitch_m: float

    @property
    def graph(self) -> Indices | None:
        """`edges`, or None for a grid, whose neighbours follow from its shape and its gaps."""
        return None if self.is_grid else self.edges

    @cached_property
    def islands(self) -> Indices:
        """Number of the group of connected taxels of each taxel, shape (n,), in the order of their first taxels."""
        from scipy.sparse import coo_array  # no verb waits for SciPy that has no need of it
        from scipy.sparse.csgraph import connected_components

        count = len(self.positions_m)
        ones = np.ones(len(self.edges), np.bool_)
        graph = coo_array((ones, (self.edges[:, 0], self.edges[:, 1])), shape=(count, count))
        return np.asarray(connected_components(graph, directed=False)[1]).astype(np.intp)

    def spread(self, taxels: npt.NDArray[np.bool_], steps: int) -> npt.NDArray[np.bool_]:
        """Return taxels, shape (n,), with all that are at most `steps` edges away from them."""
        found, (first, second) = taxels.copy(), self.edges.T
        for _ in range(steps):
            is_reached = found[first] | found[second]
            found[first[is_reached]] = found[second[is_reached]] = True
        return found

    def name_of(self, taxel: int) -> str:
        """Name a taxel in words: by its number, and on a grid by row and column, too."""
        row, column = divmod(taxel, self.shape[1])
        return f"taxel {taxel} (row {row}, column {column})" if self.is_grid else f"taxel {taxel}"

    @cached_property
    def fingerprint(self) -> str:
        """16 hex digits that differ if a taxel lies or faces elsewhere; empty for a grid, which `shape` tells."""
        if self.is_grid:
            return ""
        digest = hashlib.sha256(np.rint(self.positions_m * 1e7).astype("<i8").tobytes())
        digest.update(np.rint(self.normals * 1e3).astype("<i2").tobytes())
        return digest.hexdigest()[:16]

    @cached_property
    def is_border(self) -> npt.NDArray[np.bool_]:
        """Which taxels are at the border of the skin, or of one of its gaps, shape (n,).

        Around such a taxel, two neighbours that follow each other are more than `BORDER_RAD` apart.
        """
        taxel, other = np.concatenate((self.edges, self.edges[:, ::-1])).T
        normal = self.normals[taxel]
        across = np.cross(normal, np.eye(3)[np.abs(normal).argmin(axis=1)])
        way = self.positions_m[other] - self.positions_m[taxel]
        angle = np.arctan2((np.cross(normal, across) * way).sum(axis=1), (across * way).sum(axis=1))
        order = np.lexsort((angle, taxel))
        taxel, angle = taxel[order], angle[order]
        first = np.searchsorted(taxel, np.arange(len(self.positions_m)))
        degree = np.bincount(taxel, minlength=len(first))
        following = np.arange(1, len(taxel) + 1)
        last = (first + degree - 1)[degree > 0]
        following[last] = first[degree > 0]
        left = np.zeros(len(first))
        left[degree < 2] = 2 * np.pi
        np.maximum.at(left, taxel, (angle[following] - angle) % (2 * np.pi))
        return np.asarray(left > BORDER_RAD, np.bool_)

    @cached_property
    def is_flat(self) -> bool:
        """Whether all taxels lie in a plane, to a tenth of the pitch."""
        centred = self.positions_m - self.positions_m.mean(axis=0)
        return bool(np.abs(centred @ np.linalg.svd(centred, full_matrices=False)[2][2]).max() < 0.1 * self.pitch_m)


def grid_surface(rows: int, columns: int, pitch_m: float, gaps: Indices) -> Surface:
    """Return the surface of a grid; `gaps` are the taxels that it lacks, row-major."""
    row, column = np.divmod(np.arange(rows * columns), columns)
    places = np.stack((column - (columns - 1) / 2, row - (rows - 1) / 2, np.zeros(row.size)), axis=1)
    taxel, is_gap = np.arange(rows * columns).reshape(rows, columns), np.zeros(rows * columns, np.bool_)
    is_gap[gaps] = True
    beside, below = (taxel[:, :-1], taxel[:, 1:]), (taxel[:-1], taxel[1:])
    edges = np.concatenate([np.stack((low.ravel(), high.ravel()), axis=1) for low, high in (beside, below)])
    return Surface(
        positions_m=places * pitch_m,
        normals=np.tile(GRID_NORMAL, (rows * columns, 1)),
        edges=_sorted(edges[~is_gap[edges].any(axis=1)]),
        shape=(rows, columns),
        is_grid=True,
        pitch_m=pitch_m,
    )


def surface_of_positions(places: Sequence[Sequence[float]], link_ratio: float = LINK_RATIO) -> Surface:
    """Return the surface of taxels at positions.

    Parameters
    ----------
    places : sequence of 3 or 6 numbers each
        x, y and z in metres, and the normal, of any length above 0. Normals that are not given are those of the plane
        through the taxels around, and point away from the middle of the skin; of a flat skin along its largest axis.
    link_ratio : float
        Neighbours are at most this times the median spacing apart.

    Raises
    ------
    LayoutError
        If the numbers are no such table, or a taxel has no neighbour.
    """
    from scipy.spatial import cKDTree

    table = _checked(places)
    positions_m, told = table[:, :3], table[:, 3:]
    tree = cKDTree(positions_m)

    def same_side(first: Indices, second: Indices) -> npt.NDArray[np.bool_]:
        """Tell which pairs of taxels face the same side; without normals all."""
        return np.asarray(
            (told[first] * told[second]).sum(axis=-1) > 0 if told.size else np.ones(first.shape), np.bool_
        )

    away_m, near = tree.query(positions_m, min(NEAREST, len(table)))
    mine = np.broadcast_to(np.arange(len(table))[:, None], near.shape)
    nearest_m, second_m = np.sort(np.where(same_side(mine, near) & (near != mine), away_m, np.inf), axis=1)[:, :2].T
    pitch_m = float(np.median(second_m))
    if twice := np.flatnonzero(nearest_m <= 1e-3 * pitch_m).tolist():
        other = next(each for each in near[twice[0]].tolist() if each != twice[0])
        raise LayoutError(f"taxels {twice[0]} and {other} lie at the same place")
    if not pitch_m <= SPACING_MAX_M:
        raise LayoutError(f"taxels are {pitch_m:g} m apart: the numbers look like millimetres, expected metres")
    pairs = tree.query_pairs(link_ratio * pitch_m, output_type="ndarray")
    pairs = pairs[same_side(pairs[:, 0], pairs[:, 1])]
    ends_m = positions_m[pairs]
    apart_m = np.linalg.norm(ends_m[:, 0] - ends_m[:, 1], axis=1)
    within = tree.query_ball_point(ends_m.mean(axis=1), SPHERE_RATIO * apart_m / 2)
    pair = np.repeat(np.arange(len(pairs)), [len(each) for each in within])
    third = np.array([taxel for each in within for taxel in each], np.intp)
    inside = np.bincount(pair[same_side(pairs[pair, 0], third)], minlength=len(pairs))
    edges = _sorted(pairs[inside == 2])  # the two themselves
    alone = np.setdiff1d(np.arange(len(table)), edges)
    if alone.size:
        limit = f"{link_ratio:g} times the median spacing of {1e3 * pitch_m:.3g} mm"
        raise LayoutError(f"taxel {alone[0]} has no neighbour within {limit} that faces the same side")
    normals = told if told.size else _normals(positions_m, edges)
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    return Surface(positions_m, normals, edges, (1, len(table)), is_grid=False, pitch_m=pitch_m)


def _checked(places: Sequence[Sequence[float]]) -> Floats:
    if len(places) < FEWEST:
        raise LayoutError(f"expected {FEWEST} taxels or more, got {len(places)}")
    widths = sorted({len(place) for place in places})
    if widths not in ([3], [6]):
        raise LayoutError(f"expected x, y and z of each taxel, or these and the normal: got {widths} numbers")
    table = np.array(places, np.float64)
    wrong = np.flatnonzero(~np.isfinite(table).all(axis=1))
    if wrong.size:
        raise LayoutError(f"expected finite numbers, got {table[wrong[0]].tolist()} of taxel {wrong[0]}")
    zero = np.flatnonzero(~table[:, 3:].any(axis=1))
    if widths == [6] and zero.size:
        raise LayoutError(f"the normal of taxel {zero[0]} has length 0: expected a direction out of the skin")
    return table


def _normals(positions_m: Floats, edges: Indices) -> Floats:
    """Return the normals of planes through the nearest taxels, neighbours alike, away from the middle of the skin."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import breadth_first_order, connected_components
    from scipy.spatial import cKDTree

    count = len(positions_m)
    near = cKDTree(positions_m).query(positions_m, min(NEAREST, count))[1]
    around = positions_m[near] - positions_m[near].mean(axis=1, keepdims=True)
    normals = np.linalg.svd(around, full_matrices=False)[2][:, 2]
    graph = coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(count, count)).tocsr()
    islands = connected_components(graph, directed=False)[1]
    centre = positions_m.mean(axis=0)
    for island in range(int(islands.max()) + 1):
        members = np.flatnonzero(islands == island)
        order, before = breadth_first_order(graph, members[0], directed=False)
        for taxel in order[1:]:
            if normals[taxel] @ normals[before[taxel]] < 0:
                normals[taxel] *= -1
        outward = float(((positions_m[members] - centre) * normals[members]).sum())
        scale = float(np.abs(positions_m - centre).max()) * members.size
        mean = normals[members].sum(axis=0)
        if outward < -1e-3 * scale or (abs(outward) <= 1e-3 * scale and mean[np.abs(mean).argmax()] < 0):
            normals[members] *= -1
    return normals


def _sorted(edges: Indices) -> Indices:
    low_first = np.sort(edges, axis=1)
    return low_first[np.lexsort((low_first[:, 1], low_first[:, 0]))].astype(np.intp)
