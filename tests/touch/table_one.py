"""Table I's way of counting, written out independently of the reconstructor."""

from typing import Final

import numpy as np
import numpy.typing as npt

#: |coefficient| above which Table I counts one, newtons.
THRESHOLD_N: Final = 0.001


def haar_counts(force_n: npt.NDArray[np.float32]) -> npt.NDArray[np.intp]:
    """Return how many coefficients of the tensor Haar transform of each image count."""
    haar = full_haar(force_n.shape[-1])
    counts: npt.NDArray[np.intp] = (np.abs(haar @ force_n @ haar.T) > THRESHOLD_N).sum(axis=(1, 2))
    return counts


def full_haar(n: int) -> npt.NDArray[np.float32]:
    transform = np.ones((1, 1))
    while transform.shape[0] < n:
        size = transform.shape[0]
        transform = np.concatenate([np.kron(transform, [1.0, 1.0]), np.kron(np.eye(size), [1.0, -1.0])]) / np.sqrt(2.0)
    np.testing.assert_allclose(transform @ transform.T, np.eye(n), atol=1e-12)
    return transform.astype(np.float32)
