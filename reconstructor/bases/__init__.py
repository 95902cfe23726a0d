"""Bases Ψ in which a touch is sparse: analysis s = Ψᵀx and synthesis x = Ψs."""

from collections.abc import Callable
from typing import Final

from reconstructor.bases.basis import Basis
from reconstructor.bases.contourlet import Contourlet
from reconstructor.bases.dct import Dct
from reconstructor.bases.names import wavelet_of
from reconstructor.bases.pyramid import Pyramid, daubechies4_pyramid, haar_pyramid
from reconstructor.bases.separable import Separable, daubechies4_tensor, haar_tensor, wavelet_tensor

#: The paper's bases by name, and DCT; "tensor" is the form of the paper's tables, "pyramid" that of Mallat.
BASES: Final[dict[str, Callable[[int, int], Basis]]] = {
    "haar-tensor": haar_tensor,
    "haar-pyramid": haar_pyramid,
    "d4-tensor": daubechies4_tensor,
    "d4-pyramid": daubechies4_pyramid,
    "dct": Dct,
    "contourlet": Contourlet,
}


def make_basis(name: str, rows: int, columns: int) -> Basis:
    """Return the basis `name` for a grid: of `BASES`, or of any orthogonal wavelet (`wavelet_basis_name`).

    Raises
    ------
    InputError
        If the name is unknown or the grid does not fit.
    """
    return BASES[name](rows, columns) if name in BASES else wavelet_basis(name, rows, columns)


def wavelet_basis(name: str, rows: int, columns: int) -> Pyramid | Separable:
    """Return the basis of any orthogonal wavelet, the paper's among them; raises as `make_basis`."""
    wavelet, form = wavelet_of(name)
    return Pyramid(rows, columns, wavelet) if form == "pyramid" else wavelet_tensor(wavelet, rows, columns)


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
    "wavelet_basis",
]
