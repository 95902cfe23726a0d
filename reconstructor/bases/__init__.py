"""Bases Ψ in which a touch is sparse: analysis s = Ψᵀx and synthesis x = Ψs."""

from collections.abc import Callable
from typing import Final

from canskin.errors import InputError
from reconstructor.bases.basis import Basis
from reconstructor.bases.contourlet import Contourlet
from reconstructor.bases.dct import Dct
from reconstructor.bases.pyramid import Pyramid, daubechies4_pyramid, haar_pyramid
from reconstructor.bases.separable import Separable, daubechies4_tensor, haar_tensor

#: Every basis by name; "tensor" is the form of the paper's tables, "pyramid" that of Mallat.
BASES: Final[dict[str, Callable[[int, int], Basis]]] = {
    "haar-tensor": haar_tensor,
    "haar-pyramid": haar_pyramid,
    "d4-tensor": daubechies4_tensor,
    "d4-pyramid": daubechies4_pyramid,
    "dct": Dct,
    "contourlet": Contourlet,
}


def make_basis(name: str, rows: int, columns: int) -> Basis:
    """Return the basis `name` for a grid.

    Raises
    ------
    InputError
        If the name is unknown or the grid does not fit.
    """
    if name not in BASES:
        raise InputError(f"unknown basis '{name}': expected one of {', '.join(BASES)}")
    return BASES[name](rows, columns)


__all__ = [
    "BASES",
    "Basis",
    "Contourlet",
    "Dct",
    "Pyramid",
    "Separable",
    "daubechies4_pyramid",
    "daubechies4_tensor",
    "haar_pyramid",
    "haar_tensor",
    "make_basis",
]
