"""Bases Ψ in which a touch is sparse: analysis s = Ψᵀx and synthesis x = Ψs."""

from reconstructor.bases.basis import Basis
from reconstructor.bases.contourlet import Contourlet
from reconstructor.bases.dct import Dct
from reconstructor.bases.wavelets import WaveletBasis, wavelet_basis


def make_basis(name: str, rows: int, columns: int) -> Basis:
    """Return the basis `name` for a grid: ``dct``, ``contourlet``, or that of any orthogonal wavelet."""
    if name == "dct":
        return Dct(rows, columns)
    return Contourlet(rows, columns) if name == "contourlet" else wavelet_basis(name, rows, columns)


__all__ = ["Basis", "Contourlet", "Dct", "WaveletBasis", "make_basis", "wavelet_basis"]
