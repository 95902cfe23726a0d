"""The interface of all bases."""

from typing import Any, Protocol

import numpy as np

from reconstructor.checks import Values


class Basis(Protocol):
    """Ψ of images of `image_shape`; `shape` is that of its coefficients, equal for an orthonormal Ψ.

    Both directions take finite float32 or float64 of the right shape, keep the dtype, and raise InputError for any
    other input.
    """

    @property
    def image_shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        ...

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the coefficients."""
        ...

    @property
    def dtype(self) -> np.dtype[Any]:
        """Dtype of the entries of Ψ."""
        ...

    def forward(self, image: Values) -> Values:
        """Return the analysis s = Ψᵀx; for an orthonormal Ψ also Ψ⁻¹x."""
        ...

    def adjoint(self, coefficients: Values) -> Values:
        """Return the synthesis x = Ψs."""
        ...
