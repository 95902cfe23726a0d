"""The interface of all bases."""

from typing import Protocol

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

    def forward(self, image: Values) -> Values:
        """Return the analysis s = Ψᵀx; for an orthonormal Ψ also Ψ⁻¹x."""
        ...

    def adjoint(self, coefficients: Values) -> Values:
        """Return the synthesis x = Ψs."""
        ...
