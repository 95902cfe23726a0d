"""What is taken off sums before images are made of them, and set right in images: known gains, and masked taxels."""

import numpy as np
import numpy.typing as npt

from reconstructor.gains import GainCorrection, KnownGains
from reconstructor.masked import MaskedTaxels
from skin.layout import Layout

Floats = npt.NDArray[np.float32]
Bools = npt.NDArray[np.bool_]


class Corrections:
    """The corrections of a skin, one image after the other.

    Parameters
    ----------
    gains : KnownGains, optional
        Of taxels and sums.
    """

    def __init__(self, layout: Layout, gains: KnownGains | None = None) -> None:
        self._newton_per_count = np.float32(layout.taxels.newton_per_count)
        self._each: list[GainCorrection | MaskedTaxels] = []
        if gains is not None:
            self._each.append(GainCorrection(layout.phi(), gains))
        if layout.taxels.masked:
            self._each.append(MaskedTaxels(layout))

    def apply(self, counts: npt.NDArray[np.int32], valid: Bools) -> tuple[Floats, Bools]:
        """Return the corrected sums, newtons, and which of them are valid, of sums in counts and the same."""
        sums_n = np.multiply(counts, self._newton_per_count, dtype=np.float32)
        for each in self._each:
            sums_n, valid = each.apply(sums_n, valid)
        return sums_n, valid

    def keep(self, image: Floats) -> Floats:
        """Return the corrected image, newtons, and keep it for the next sums."""
        for each in reversed(self._each):
            image = each.keep(image)
        return image
