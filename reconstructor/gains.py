"""Known gains of taxels and of analogue sums, where the solvers know y = Φ f.

Φ with gains has the rows (D_k H_k + C_k H_0) diag(g) (`skin.defects.SumGains`; 1 and 0 where nodes add numbers).
Sums are divided by D. Less (H_k diag(g - 1) + C_k / D_k H_0 diag(g)) f they are then those of Φ. The image of the cycle
before stands for f: so the error of the correction is that of g - 1 and C times the change of the force in a cycle. The
solver and its fast Φ stay as they are, and the sparse image is that of the forces. A sum that feels next to nothing has
no part in the image.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from skin.defects import SumGains
from skin.frontend import LEAST_FELT, felt_by_sums
from skin.phi import Sbhe, fast_hadamard

Floats = npt.NDArray[np.float32]
Bools = npt.NDArray[np.bool_]


class KnownGains(NamedTuple):
    """Gains of a skin.

    Attributes
    ----------
    taxels : array, shape (n,)
        Reading / force of each taxel, row-major.
    sums : SumGains, optional
        Of an analogue front end.
    """

    taxels: npt.NDArray[np.floating]
    sums: SumGains | None = None


class GainCorrection:
    """Takes known gains off sums, one cycle after the other."""

    def __init__(self, phi: Sbhe, gains: KnownGains) -> None:
        from scipy.sparse import csr_array

        taxels = phi.taxels_of_blocks[phi.block_of_sum]
        signs = np.asarray(fast_hadamard(np.eye(phi.block_size)))[phi.row_of_sum]
        sums = np.repeat(np.arange(phi.shape[0]), phi.block_size)
        of_taxels = phi.padded(gains.taxels)[taxels]
        excess = (of_taxels - 1) * signs
        self._differential: np.float32 | Floats = np.float32(1)
        self._usable = np.ones(phi.shape[0], np.bool_)
        if gains.sums is not None:
            self._usable = felt_by_sums(phi, gains.sums) >= LEAST_FELT
            differential = np.where(self._usable, gains.sums.differential, 1.0)
            self._differential = differential.astype(np.float32)
            excess += (gains.sums.common_mode / differential)[:, None] * of_taxels
        excess = excess.astype(np.float32)
        places = csr_array((excess.ravel(), (sums.ravel(), taxels.ravel())), shape=phi.wired.shape)
        self._excess = places[:, : phi.shape[1]]
        self._before = np.zeros(phi.shape[1], np.float32)

    def apply(self, sums_n: Floats, valid: Bools) -> tuple[Floats, Bools]:
        """Return the sums without gains, newtons, and which of them are valid, of sums of shape (m,) and the same."""
        corrected: Floats = sums_n / self._differential - self._excess @ self._before
        return corrected, valid & self._usable

    def keep(self, image: Floats) -> Floats:
        """Keep the image for the next cycle; return the image."""
        self._before = image.ravel()
        return image
