"""What every basis can do."""

from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from skin.errors import InputError

Values = npt.NDArray[np.floating[Any]]


class Basis(Protocol):
    """Ψ of images of `image_shape`; `shape` is that of its coefficients, equal for an orthonormal Ψ.

    Both directions keep the dtype of floating arrays.
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
        """Of the entries of Ψ."""
        ...

    def forward(self, image: Values) -> Values:
        """Return the analysis s = Ψᵀx; for an orthonormal Ψ also Ψ⁻¹x."""
        ...

    def adjoint(self, coefficients: Values) -> Values:
        """Return the synthesis x = Ψs."""
        ...


def check_grid(rows: int, columns: int) -> None:
    """Raise InputError unless both sides are powers of two, 8 to 256."""
    for size in (rows, columns):
        if size & (size - 1) or not 8 <= size <= 256:
            raise InputError(f"a basis needs sides that are powers of two, 8 to 256: got {rows} x {columns}")
