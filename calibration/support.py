"""How the zero of each block is supported, and since when."""

from typing import Final

import numpy as np

from calibration.windows import TARE_WINDOWS, Bools, Window
from calibration.zero import Zero
from canskin.calibration_messages import ZeroSupport
from skin.measurement import Sbhe

#: Windows without touch after which a skin supports its zero.
CALM_WINDOWS: Final = TARE_WINDOWS


class Support:
    """Follows the support of the zero of every block.

    Parameters
    ----------
    phi : Sbhe

    Attributes
    ----------
    of_blocks : array of uint8, shape (blocks,)
        `ZeroSupport`.
    since_ns : array of int64, shape (blocks,)
        When the zero was last measured or told; 0 for never.
    """

    def __init__(self, phi: Sbhe) -> None:
        self._phi = phi
        self.of_blocks = np.full(phi.blocks, ZeroSupport.NONE, np.uint8)
        self.since_ns = np.zeros(phi.blocks, np.int64)
        self._calm = 0

    def begin(self, known: Bools, support: ZeroSupport, time_ns: int) -> None:
        """Begin with a zero of the sums `known`, shape (m,)."""
        whole = self._whole(known)
        self.of_blocks = np.where(whole, support, ZeroSupport.NONE).astype(np.uint8)
        self.since_ns = np.where(whole & (support > ZeroSupport.STORED), time_ns, 0)
        self._calm = 0

    def tell(self, taxels: Bools, time_ns: int) -> None:
        """Note a person's word on some taxels, shape (n,)."""
        blocks = np.unique(self._phi.block_of_taxel[taxels])
        self.of_blocks[blocks], self.since_ns[blocks] = ZeroSupport.TOLD, time_ns

    def take(self, zero: Zero, window: Window) -> None:
        """Look at the zero after a window. A person's word counts until the zero falls."""
        self.of_blocks[self._phi.block_of_taxel[zero.fallen]] = ZeroSupport.CORRECTED
        came = self._whole(zero.follower.known & window.known)
        is_calm = came.any() and not zero.touched.any() and not zero.fallen.any()
        self._calm = self._calm + 1 if is_calm else 0
        if self._calm >= CALM_WINDOWS:
            self.of_blocks[came & (self.of_blocks != ZeroSupport.TOLD)] = ZeroSupport.MEASURED
        self.since_ns[came & ~zero.held & (self.of_blocks == ZeroSupport.MEASURED)] = window.centre_ns

    def _whole(self, known: Bools) -> Bools:
        return np.asarray(self._phi.all_of_blocks(known) & self._phi.has_sums, np.bool_)
