"""From Walsh sums of patches to the tactile image: the inverse transform, then less total variation.

A sum that is unknown counts as 0, or is filled in: of all images with the known sums, the smoothest. What the nodes'
filter leaves of their noise, and what the codes of the sums round away, is taken out of the image by a few steps of the
dual of the total variation (Chambolle 2004) for each image; the dual is kept, so that a skin at rest converges.
"""

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError
from reconstructor.checks import check_values
from reconstructor.kernels.filling import fill
from reconstructor.kernels.graph import Graph, graph_of
from reconstructor.kernels.transforms import FAST_MATH
from reconstructor.kernels.variation import denoise
from shell.compiled import borrowed, njit
from skin.walsh import grouped_rows, walsh_matrix

#: Limit of the dual, in units of the nodes' noise.
LIMIT_RATIO: Final = 0.1
#: Steps of the dual for each image.
STEPS: Final = 8

Floats = npt.NDArray[np.float32]


class _Walsh(NamedTuple):
    """Arrays of a `WalshReconstructor`; `work` is scratch.

    Attributes
    ----------
    cells : array of int, shape (patches, taxels)
    rows : array of int, shape (taxels,)
        Of the sums of a patch, that of each sum in the order of `skin.walsh.grouped_rows`.
    sums_n : array of float32, shape (patches, taxels)
    unknown : array of bool, shape (patches, taxels)
    places, filled : arrays of float32, shape (places,)
    work : array of float32, shape (4, places)
    dual : array of float32
    """

    cells: Any
    rows: Any
    sums_n: Any
    unknown: Any
    places: Any
    filled: Any
    work: Any
    dual: Any


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _scale(values: Any, known: Any, factor: Any, walsh: _Walsh) -> int:
    """Group the sums of all patches, and scale them; return how many are unknown."""
    walsh, size, total = borrowed(walsh), walsh.rows.size, 0
    for patch in range(walsh.sums_n.shape[0]):
        for place in range(size):
            total += not known[patch * size + place]
            walsh.unknown[patch, place] = not known[patch * size + place]
        for place in range(size):
            at = patch * size + walsh.rows[place]
            walsh.sums_n[patch, place] = np.float32(values[at]) * factor if known[at] else np.float32(0)
    return total


@njit(cache=True, nogil=True, fastmath=FAST_MATH)
def _restore(patches_n: Any, is_whole: bool, graph: Graph, limit_n: Any, made: Any, walsh: _Walsh) -> None:  # noqa: PLR0917
    """Make an image of the forces on the taxels of each patch."""
    walsh, graph = borrowed(walsh), borrowed(graph)
    for patch in range(walsh.cells.shape[0]):
        for place in range(walsh.cells.shape[1]):
            walsh.places[walsh.cells[patch, place]] = patches_n[patch, place]
    if is_whole:
        walsh.filled[:] = 0
    else:
        fill(walsh.places, made.size, graph, walsh.unknown, walsh.cells, walsh.filled, walsh.work)
    denoise(walsh.places[: made.size], made, walsh.dual, graph, STEPS, limit_n, np.float32(0))


class VariationFilter:
    """Takes total variation out of images, one after the other; forces do not fall below 0.

    Parameters
    ----------
    graph : Graph
        Of the taxels of every image.
    """

    def __init__(self, graph: Graph) -> None:
        self._dual = np.zeros(graph.size, np.float32)
        self._graph = graph

    def __call__(self, image_n: Floats, limit_n: float) -> Floats:
        """Return the image with less total variation, float32, shape (rows, columns), newtons.

        Parameters
        ----------
        image_n : array of float32, shape (rows, columns)
        limit_n : float
            Neighbours that differ by less become equal, given time.
        """
        made = np.empty(image_n.size, np.float32)
        denoise(image_n.ravel(), made, self._dual, self._graph, STEPS, np.float32(limit_n), np.float32(0))
        return made.reshape(image_n.shape)


class WalshReconstructor:
    """Makes an image of the Walsh sums of all patches.

    Raise InputError if the patches hold a taxel twice. A taxel that none holds is a gap.

    Parameters
    ----------
    patches : sequence of int arrays, shape (patches of a bus, taxels)
        Row-major indices of the taxels of each patch and of empty places, by bus, see `skin.walsh.patches`.
    noise_n : float
        Median over the nodes of their noise, newtons; may be set anew between images.
    edges : array of int, shape (edges, 2), optional
        Pairs of neighbours of a skin that is no grid (`skin.surface.Surface.graph`).
    """

    def __init__(
        self,
        patches: Sequence[npt.NDArray[Any]],
        rows: int,
        columns: int,
        noise_n: float,
        edges: npt.NDArray[np.intp] | None = None,
    ) -> None:
        cells = np.concatenate(patches)
        # The empty places follow the taxels; gaps of the grid are 0.
        places = max(rows * columns, int(cells.max()) + 1)
        held = np.bincount(cells.ravel(), minlength=places)
        if held.max() > 1 or not held[rows * columns :].all():
            raise InputError(f"expected patches that hold each of {rows * columns} taxels once")
        self._graph = graph_of(rows, columns, np.flatnonzero(held[: rows * columns] == 0), edges)
        taxels = cells.shape[1]
        self._inverse = walsh_matrix(taxels) / np.float32(taxels)
        self._shape = rows, columns
        self._walsh = _Walsh(
            cells=cells,
            rows=grouped_rows(taxels).ravel(),
            sums_n=np.zeros(cells.shape, np.float32),
            unknown=np.zeros(cells.shape, np.bool_),
            places=np.zeros(places, np.float32),
            filled=np.zeros(places, np.float32),
            work=np.zeros((4, places), np.float32),
            dual=np.zeros(self._graph.size, np.float32),
        )
        self.noise_n = noise_n

    def solve(self, sums_n: Floats, known: npt.NDArray[np.bool_] | None = None) -> Floats:
        """Return the image, float32, shape (rows, columns), newtons.

        Parameters
        ----------
        sums_n : array of float32, shape (patches, taxels)
            Of all patches, in the order of `patches`; the sums of each in that of `skin.walsh.grouped_rows`, newtons.
        known : array of bool, shape (patches, taxels), optional
            Which sums are known; the others are filled in from the forces around. Without `known`, all sums count as
            they are. An image without any known sum is 0.
        """
        shape = self._walsh.cells.shape
        check_values("sums", sums_n, shape)
        if known is not None and (known.shape != shape or known.dtype != np.bool_):
            raise InputError(f"known: expected booleans of shape {shape}, got {known.dtype} {known.shape}")
        if known is None or known.all():
            return self._restored(sums_n, 0)
        self._walsh.unknown[:, self._walsh.rows] = ~known
        return self._restored(np.where(known, sums_n, np.float32(0)), int(np.count_nonzero(~known)))

    def solve_sums(self, values: npt.NDArray[Any], known: npt.NDArray[np.bool_], factor: np.float32) -> Floats:
        """Return the image of sums in the order of Φ, shape (m,), that are newtons with a factor; see `solve`."""
        unknown = _scale(values, known, factor, self._walsh)
        return self._restored(self._walsh.sums_n, unknown)

    def _restored(self, sums_n: npt.NDArray[Any], unknown: int) -> Floats:
        """Return the image of sums, those that are not known 0, of which `unknown` are not."""
        if unknown == self._walsh.cells.size:
            self.reset()
            return np.zeros(self._shape, np.float32)
        made = np.empty(self._shape, np.float32)
        limit_n = np.float32(LIMIT_RATIO * self.noise_n)
        _restore(sums_n @ self._inverse, unknown == 0, self._graph, limit_n, made.reshape(-1), self._walsh)
        return made

    def reset(self) -> None:
        """Forget the images before."""
        self._walsh.dual[:] = 0
        self._walsh.filled[:] = 0
