"""Masked taxels (`taxels.masked`): broken ones, whose readings have no effect on images.

A taxel adds its reading, with the signs of its column of Φ, to all sums of its block. Of the sums less those of the
image before, what the columns of masked taxels explain is taken off. What is left does not depend on their readings,
and tells the forces on the other taxels of the block, if it has more sums than masked taxels. In images a masked taxel
has the mean of its neighbours.
"""

import numpy as np
import numpy.typing as npt

from skin.layout import Layout
from skin.phi import fast_hadamard

Floats = npt.NDArray[np.float32]
Bools = npt.NDArray[np.bool_]


class MaskedTaxels:
    """Takes masked taxels off sums, one image after the other.

    Parameters
    ----------
    layout : Layout
        With masked taxels.
    """

    def __init__(self, layout: Layout) -> None:
        taxels, phi = layout.taxels, layout.phi()
        self._phi, self._is_masked = phi, taxels.is_masked & phi.is_wired
        masked = np.flatnonzero(self._is_masked)
        #: How many masked taxels each block has; sums of such blocks, their taxels, and these taxels' signs.
        self._of_blocks = np.bincount(phi.block_of_taxel[masked], minlength=phi.blocks)
        self._rows = np.flatnonzero(self._of_blocks[phi.block_of_sum])
        self._taxels = phi.taxels_of_blocks[phi.block_of_sum[self._rows]]
        self._signs = np.asarray(fast_hadamard(np.eye(phi.block_size)), np.float32)[phi.row_of_sum[self._rows]]
        #: Signs of the masked taxels alone, shape (rows, masked taxels).
        self._columns = np.where(self._taxels[..., None] == masked, self._signs[..., None], 0).sum(axis=1)
        pairs = np.concatenate((taxels.surface.edges, taxels.surface.edges[:, ::-1]))
        self._near = pairs[self._is_masked[pairs[:, 0]] & ~self._is_masked[pairs[:, 1]]]
        self._before = phi.padded(np.zeros(taxels.count, np.float32))
        self._valid, self._used = np.zeros((2, self._rows.size), np.bool_)
        self._fit = np.zeros((masked.size, 0), np.float32)

    def apply(self, sums_n: Floats, valid: Bools) -> tuple[Floats, Bools]:
        """Return sums without masked taxels, newtons, and which are valid, of sums of shape (m,) and the same."""
        if not np.array_equal(valid[self._rows], self._valid):
            self._valid = valid[self._rows]
            is_enough = self._phi.total_of_blocks(valid) > self._of_blocks
            self._used = self._valid & is_enough[self._phi.block_of_sum[self._rows]]
            self._fit = np.linalg.pinv(self._columns[self._used])
        rest_n = sums_n[self._rows] - (self._signs * self._before[self._taxels]).sum(axis=1)
        sums_n, valid = sums_n.copy(), valid.copy()
        sums_n[self._rows] -= self._columns @ (self._fit @ rest_n[self._used])
        valid[self._rows] = self._used
        return sums_n, valid

    def keep(self, image: Floats) -> Floats:
        """Return an image, newtons, with the mean of the neighbours at masked taxels; keep it for the next sums."""
        forces_n = image.ravel().copy()
        masked, near = self._near.T
        number = np.maximum(np.bincount(masked, minlength=forces_n.size), 1)
        mean_n = np.bincount(masked, forces_n[near], forces_n.size) / number
        forces_n[self._is_masked] = mean_n[self._is_masked]
        self._before = self._phi.padded(forces_n)
        return forces_n.reshape(image.shape)
