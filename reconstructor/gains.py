"""Known gains of taxels in the sums: y = Φ diag(g) f, where the solvers know y = Φ f.

The sums less Φ diag(g - 1) f are those of taxels without gains. The image of the cycle before stands for f: so the
error of the correction is (g - 1) times the change of the force in a cycle. The solver stays as it is, and its sparse
image is that of the forces.
"""

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array

from skin.measurement import Sbhe, fast_hadamard

Floats = npt.NDArray[np.float32]


class GainCorrection:
    """Takes the known gains of taxels off sums, one cycle after the other.

    Parameters
    ----------
    phi : Sbhe
    gains : array, shape (n,)
        Reading / force of each taxel, row-major.
    """

    def __init__(self, phi: Sbhe, gains: npt.NDArray[np.floating]) -> None:
        taxels = phi.taxels_of_blocks[phi.block_of_sum]
        signs = np.asarray(fast_hadamard(np.eye(phi.block_size)))[phi.row_of_sum]
        sums = np.repeat(np.arange(phi.shape[0]), phi.block_size)
        excess = ((gains[taxels] - 1) * signs).astype(np.float32)
        self._excess = csr_array((excess.ravel(), (sums, taxels.ravel())), shape=phi.shape)
        self._before = np.zeros(phi.shape[1], np.float32)

    def apply(self, sums_n: Floats) -> Floats:
        """Return the sums of taxels without gains, newtons, shape (m,)."""
        corrected: Floats = sums_n - self._excess @ self._before
        return corrected

    def keep(self, image: Floats) -> None:
        """Keep the image for the next cycle."""
        self._before = image.ravel()
