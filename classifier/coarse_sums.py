"""Which sums the classifier uses: all, those of recognition, or with adaptive sending the coarse ones."""

import numpy as np

from skin.layout import Layout
from skin.measurement import Sbhe
from skin.walsh import grouped_rows


def classified_phi(layout: Layout) -> Sbhe:
    """Return the Φ of the sums that the classifier uses.

    Of a skin with adaptive sending group 0 of each block: the sums that show means of 2 x 2 taxels.
    """
    if layout.sending == "synchronous":
        return layout.recognising().phi()
    phi = layout.phi()
    kept = np.zeros_like(phi.kept)
    kept[:, grouped_rows(phi.block_size)[0]] = True
    return Sbhe(phi.order, kept)
