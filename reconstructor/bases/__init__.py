"""Bases Ψ in which a touch is sparse: analysis s = Ψᵀx and synthesis x = Ψs."""

from reconstructor.bases.basis import Basis
from reconstructor.bases.wavelets import WaveletBasis, wavelet_basis

__all__ = ["Basis", "WaveletBasis", "wavelet_basis"]
