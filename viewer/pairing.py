"""Which image and which truth belong to one cycle."""

from typing import Final

import numpy as np
import numpy.typing as npt

from skin.messages import Image, Truth

#: The SYNC counter comes round (after 2.4 s at 100 Hz); messages of one cycle lie closer together than this.
SAME_CYCLE_NS: Final = 1_000_000_000
#: SYNC counters run from 1 to 240 (CiA 301, 7.2.5.1): more cycles cannot be told apart.
REMEMBERED: Final = 240


def same_cycle(one: Image | Truth, other: Image | Truth) -> bool:
    """Tell whether two messages belong to one SYNC cycle."""
    near = abs(one.sync_mono_ns - other.sync_mono_ns) < SAME_CYCLE_NS
    return near and one.sync_counter == other.sync_counter


class Pairing:
    """Images and truths in any order; every pair is handed out once, when its second half comes."""

    def __init__(self) -> None:
        self._truths: dict[int, Truth] = {}
        self._images: dict[int, Image] = {}

    def take_truth(self, truth: Truth) -> Image | None:
        """Remember `truth`; return the waiting image of its cycle."""
        _remember(self._truths, truth.sync_counter, truth)
        image = self._images.get(truth.sync_counter)
        if image is None or not same_cycle(image, truth):
            return None
        return self._images.pop(truth.sync_counter)

    def take_image(self, image: Image) -> Truth | None:
        """Return the truth of the image's cycle, or remember `image` until it comes."""
        truth = self.truth_of(image)
        if truth is None:
            _remember(self._images, image.sync_counter, image)
        return truth

    def truth_of(self, image: Image) -> Truth | None:
        """Return the truth of the image's cycle, if it is known."""
        truth = self._truths.get(image.sync_counter)
        return truth if truth is not None and same_cycle(image, truth) else None


def psnr_db(true: npt.NDArray[np.float32], other: npt.NDArray[np.float32], peak_n: float) -> float:
    """Return the peak signal-to-noise ratio of `other` against `true` (the paper's equation of f_PSNR).

    Parameters
    ----------
    true, other : array of float32, shape (rows, columns)
        Newtons.
    peak_n : float
        Largest force a taxel can feel, µ.

    Returns
    -------
    float
        Decibels; equal images give 200.
    """
    error = float(np.mean((true.astype(np.float64) - other) ** 2))
    return 10 * float(np.log10(peak_n**2 / max(error, peak_n**2 * 1e-20)))


def _remember(kept: "dict[int, Image] | dict[int, Truth]", counter: int, message: "Image | Truth") -> None:
    """Keep the newest `REMEMBERED` messages, by counter."""
    kept.pop(counter, None)
    kept[counter] = message  # type: ignore[assignment]  # callers pair a dict with its own kind of message
    while len(kept) > REMEMBERED:
        del kept[next(iter(kept))]
