"""FISTA for SBHE and any orthogonal wavelet: the steps are compiled, the wavelet is applied as matrices.

PyWavelets transforms the unit vectors once; a matrix of each level results.
"""

from typing import Any, Final

import numpy as np

from reconstructor.bases import wavelet_basis
from reconstructor.fista import soft
from reconstructor.kernels.steps import Problem, advance, begin, descend, gather, row
from reconstructor.kernels.transforms import Flat

#: Rows of working memory: gain, target, ahead, work, image.
SCRATCH_ROWS: Final = 5


class MatrixWavelet:
    """Called as `reconstructor.kernels.haar.solve_haar`, with the basis `name` of a grid."""

    def __init__(self, name: str, rows: int, columns: int, dtype: np.dtype[Any]) -> None:
        steps = wavelet_basis(name, rows, columns).steps
        self._levels = [(down.astype(dtype), across.astype(dtype)) for down, across in steps]

    def __call__(self, estimate: Flat, sums: Flat, weights: Flat, problem: Problem, scratch: Flat) -> int:
        """Solve in place from `estimate` and return the number of sums used."""
        threshold, floor = problem.numbers[1], problem.numbers[2]
        work, image = row(scratch, 3, estimate.size), row(scratch, 4, estimate.size)
        count, _ = begin(estimate, sums, weights, problem, scratch)
        for turn in range(problem.momentum.size):
            shift = turn % problem.tables.shape[1]
            descend(estimate.size, problem.blocks, scratch)
            gather(image, work, problem.tables[0, shift])
            self._shrink(image.reshape(problem.rows, problem.columns), threshold)
            gather(work, image, problem.tables[1, shift])
            advance(estimate, floor, problem.momentum[turn], scratch)
        return int(count)

    def _shrink(self, image: Flat, threshold: Any) -> None:
        """Replace the image by Ψ soft(Ψᵀ image)."""
        for down, across in self._levels:
            corner = image[: len(down), : len(across)]
            corner[:] = down @ corner @ across.T
        image[:] = soft(image, threshold)
        for down, across in reversed(self._levels):
            corner = image[: len(down), : len(across)]
            corner[:] = down.T @ corner @ across
