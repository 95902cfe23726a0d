"""From Walsh sums of patches to the tactile image: the inverse transform, then less total variation.

A sum that is unknown counts as 0, or is filled in: of all images with the known sums, the smoothest. What the nodes'
filter leaves of their noise, and what the codes of the sums round away, is taken out of the image by a few steps of the
dual of the total variation (Chambolle 2004) for each image; the dual is kept, so that a skin at rest converges.
"""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError
from reconstructor.checks import check_values
from reconstructor.kernels.filling import fill
from reconstructor.kernels.graph import Graph, graph_of
from reconstructor.kernels.variation import denoise
from skin.walsh import grouped_rows, walsh_matrix

#: Limit of the dual, in units of the nodes' noise.
LIMIT_RATIO: Final = 0.1
#: Steps of the dual for each image.
STEPS: Final = 8

Floats = npt.NDArray[np.float32]


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

    def reset(self) -> None:
        """Forget the images before."""
        self._dual[:] = 0


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
        self._cells = np.concatenate(patches)
        # The empty places follow the taxels; gaps of the grid are 0.
        places = max(rows * columns, int(self._cells.max()) + 1)
        held = np.bincount(self._cells.ravel(), minlength=places)
        if held.max() > 1 or not held[rows * columns :].all():
            raise InputError(f"expected patches that hold each of {rows * columns} taxels once")
        self._graph = graph_of(rows, columns, np.flatnonzero(held[: rows * columns] == 0), edges)
        taxels = self._cells.shape[1]
        self._rows = grouped_rows(taxels).ravel()
        self._inverse = walsh_matrix(taxels) / np.float32(taxels)
        self._places = np.zeros(places, np.float32)
        self._image = self._places[: rows * columns].reshape(rows, columns)
        self._filter = VariationFilter(self._graph)
        self._filled, self._work = np.zeros(places, np.float32), np.zeros((4, places), np.float32)
        self._unknown = np.zeros(self._cells.shape, np.bool_)
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
        check_values("sums", sums_n, self._cells.shape)
        if known is not None and (known.shape != self._cells.shape or known.dtype != np.bool_):
            raise InputError(f"known: expected booleans of shape {self._cells.shape}, got {known.dtype} {known.shape}")
        if known is None or known.all():
            self._places[self._cells] = sums_n @ self._inverse
            self._filled[:] = 0
        elif known.any():
            self._places[self._cells] = np.where(known, sums_n, np.float32(0)) @ self._inverse
            self._unknown[:, self._rows] = ~known
            taxels = self._image.size
            fill(self._places, taxels, self._graph, self._unknown, self._cells, self._filled, self._work)
        else:
            self.reset()
            return np.zeros_like(self._image)
        return self._filter(self._image, LIMIT_RATIO * self.noise_n)

    def reset(self) -> None:
        """Forget the images before."""
        self._filter.reset()
        self._filled[:] = 0
