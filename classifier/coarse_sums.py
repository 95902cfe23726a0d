"""Which sums the classifier uses: all of them, or with adaptive sending those that come first, the coarse ones."""

import numpy as np
import numpy.typing as npt

from skin.layout import Layout
from skin.measurement import Sbhe
from skin.walsh import grouped_rows


def classified_phi(layout: Layout) -> Sbhe:
    """Return the Φ of the sums that the classifier uses.

    Of a skin with adaptive sending group 0 of each block: the sums that show means of 2 x 2 taxels.
    """
    phi = layout.phi()
    if layout.sending == "synchronous":
        return phi
    kept = np.zeros_like(phi.kept)
    kept[:, grouped_rows(phi.block_size)[0]] = True
    return Sbhe(phi.order, kept)


def places(phi: Sbhe, classified: Sbhe) -> npt.NDArray[np.intp]:
    """Return where the sums of `classified` are among those of `phi`, shape (m of `classified`,)."""
    return np.flatnonzero(classified.kept[phi.kept])
