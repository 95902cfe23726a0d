"""What every linear operator of this project can do: measure, measure back, and say its sizes."""

from typing import Any, Protocol

import numpy as np
import numpy.typing as npt


class Operator(Protocol):
    """A matrix that is applied and never formed.

    `forward` and `adjoint` keep the dtype of floating arrays and take any leading axes.
    """

    @property
    def shape(self) -> tuple[int, int]:
        """(m, n): rows and columns."""
        ...

    @property
    def dtype(self) -> np.dtype[Any]:
        """Smallest dtype that holds every entry."""
        ...

    @property
    def norm_squared(self) -> float:
        """Largest eigenvalue of ΦᵀΦ."""
        ...

    @property
    def fingerprint(self) -> str:
        """16 hex digits that differ whenever any entry differs."""
        ...

    def forward(self, x: npt.NDArray[np.generic]) -> npt.NDArray[Any]:
        """Return Φ x, shape (..., m), of taxels (..., n)."""
        ...

    def adjoint(self, y: npt.NDArray[np.generic]) -> npt.NDArray[Any]:
        """Return Φᵀ y, shape (..., n), of sums (..., m)."""
        ...
