"""Bases Ψ in which a touch is sparse: analysis s = Ψᵀx and synthesis x = Ψs."""

from reconstructor.bases.basis import Basis
from reconstructor.bases.dct import Dct
from reconstructor.bases.haar import HaarPyramid
from reconstructor.bases.separable import Separable, daubechies4, haar_tensor

__all__ = ["Basis", "Dct", "HaarPyramid", "Separable", "daubechies4", "haar_tensor"]
