"""Which sums the classifier uses, and what noise is in them: sums of cycles, or some of stepped boards."""

from dataclasses import replace
from typing import Final

import numpy as np
import numpy.typing as npt

from classifier.features import Float32
from skin.layout import Layout
from skin.phi import Phi, Sbhe
from skin.walsh import coarse_rows

#: What nodes that average leave of the noise: less where a touch rests, more where a touch moves.
AVERAGED_NOISE_RATIO: Final = 0.2
#: Of it, what a model of stepped nodes is trained with, least and most. Steps leave less where they are touched, their
#: rounding included: 0.05 to 0.2 as a rule, 0.2 to 0.4 in one millisecond of twenty. But models that are trained with
#: 0.05 to 0.4 name no more objects of slides. Nodes that nothing touches show 0.
STEPPED_NOISE_RATIOS: Final = (0.2, 0.6)


def classified_phi(layout: Layout) -> Phi:
    """Return the Φ of the sums that the classifier uses: of a cycle, or of steps `coarse_sums`."""
    return layout.operator() if layout.sends.in_cycles else coarse_sums(layout)


def coarse_sums(layout: Layout) -> Sbhe:
    """Return the Φ of a quarter of the steps of each block: those that show means of 2 x 2 taxels."""
    phi = layout.phi()
    kept = np.zeros_like(phi.kept)
    kept[:, coarse_rows(phi.block_size)] = True
    return replace(phi, kept=kept)


def noise_ratios(layout: Layout) -> tuple[float, float]:
    """Return which part of the noise the boards leave, least and most."""
    if not layout.sends.in_cycles:
        return STEPPED_NOISE_RATIOS
    left = 1.0 if layout.samples_per_sync == 1 else AVERAGED_NOISE_RATIO
    return left, left


def silence(signal_n: Float32, true_n: Float32, least_n: Float32, phi: Sbhe) -> None:
    """Set what stepped boards do not send to 0: noise, and all of a block that nothing touches.

    A skin that nothing touches has noise everywhere, so that a stray value of one node is no contact. With noise in
    all blocks the model is right in 98.0 % of the cycles, not 99.9 %.

    Parameters
    ----------
    signal_n, true_n : array of float32, shape (count, n)
        Forces with and without noise, newtons.
    least_n : array of float32, shape (count, 1)
        What is below counts as noise.
    """
    signal_n[(signal_n < least_n) | _beside(true_n > least_n, phi)] = 0


def _beside(is_touched: npt.NDArray[np.bool_], phi: Sbhe) -> npt.NDArray[np.bool_]:
    """Return which taxels are of a block that nothing touches, while something touches another block."""
    blocks = np.any(phi.padded(is_touched)[:, phi.taxels_of_blocks], axis=2)
    somewhere = np.any(blocks, axis=1, keepdims=True)
    found = np.zeros((len(is_touched), phi.wired.taxels), np.bool_)
    found[:, phi.order] = np.repeat(~blocks & somewhere, phi.block_size, axis=1)
    return found[:, : phi.shape[1]]
