"""The interface of the linear operators of this project."""

from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError


class Operator(Protocol):
    """A matrix Φ that is applied without being stored.

    `forward` and `adjoint` keep the dtype of floating arrays and take any leading axes. They raise InputError for an
    array of another length, with NaN or infinity, or of a type other than real numbers.
    """

    @property
    def shape(self) -> tuple[int, int]:
        """(m, n): rows and columns."""
        ...

    @property
    def norm_squared(self) -> float:
        """Largest eigenvalue of ΦᵀΦ."""
        ...

    def forward(self, x: npt.NDArray[np.generic]) -> npt.NDArray[Any]:
        """Return Φ x, shape (..., m), of taxels (..., n)."""
        ...

    def adjoint(self, y: npt.NDArray[np.generic]) -> npt.NDArray[Any]:
        """Return Φᵀ y, shape (..., n), of sums (..., m)."""
        ...


def check_vectors(name: str, values: Any, size: int) -> None:
    """Raise InputError unless `values` is an array of real, finite numbers with a last axis of `size`."""
    if not isinstance(values, np.ndarray):
        raise InputError(f"{name}: expected an array with a last axis of {size}, got {type(values).__name__}")
    if values.dtype.kind not in "biuf":
        raise InputError(f"{name}: expected an array of real numbers, got {values.dtype}")
    if values.ndim == 0 or values.shape[-1] != size:
        raise InputError(f"{name}: expected an array with a last axis of {size}, got shape {values.shape}")
    if values.dtype.kind == "f" and not np.isfinite(values).all():
        raise InputError(f"{name}: expected finite numbers, got NaN or infinity")
