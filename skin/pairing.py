"""Which message and which truth belong to one cycle, and how good an image is."""

import math
from typing import Final, Generic, TypeVar

import numpy as np
import numpy.typing as npt

from skin.messages import Image, Label, Truth

#: The SYNC counter comes round (after 2.4 s at 100 Hz); messages of one cycle lie closer together than this.
SAME_CYCLE_NS: Final = 1_000_000_000
#: SYNC counters run from 1 to 240 (CiA 301, 7.2.5.1): more cycles cannot be told apart.
REMEMBERED: Final = 240
#: Images are judged while the largest true force is at least this part of the range: twice the sensor noise.
CONTACT_RATIO: Final = 0.1

Made = TypeVar("Made", Image, Label)
Kept = TypeVar("Kept", Image, Label, Truth)


class Pairing(Generic[Made]):
    """Images or labels, and truths, in any order; every pair is handed out once, when its second half comes."""

    def __init__(self) -> None:
        self._truths: dict[int, Truth] = {}
        self._waiting: dict[int, Made] = {}

    def take_truth(self, truth: Truth) -> Made | None:
        """Remember `truth`; return the waiting message of its cycle."""
        _remember(self._truths, truth)
        message = self._waiting.get(truth.sync_counter)
        if message is None or not _near(message, truth):
            return None
        return self._waiting.pop(truth.sync_counter)

    def take(self, message: Made) -> Truth | None:
        """Return the truth of the message's cycle, or remember the message until it comes."""
        truth = self.truth_of(message)
        if truth is None:
            _remember(self._waiting, message)
        return truth

    def truth_of(self, message: Made) -> Truth | None:
        """Return the truth of the message's cycle, if it is known."""
        truth = self._truths.get(message.sync_counter)
        return truth if truth is not None and _near(message, truth) else None


def decibels(mean_square_n2: npt.ArrayLike, peak_n: float) -> npt.NDArray[np.float64]:
    """Return the PSNR of mean squared errors (the paper's equation of f_PSNR).

    Parameters
    ----------
    mean_square_n2 : array_like
        Mean over an image of the squared error, newtons squared; of any shape.
    peak_n : float
        Largest force a taxel can feel, µ.

    Returns
    -------
    array of float64, the same shape
        Decibels; no error gives 200.
    """
    floored = np.maximum(mean_square_n2, peak_n**2 * 1e-20)
    return np.asarray(10 * np.log10(peak_n**2 / floored), np.float64)


def psnr_db(true: npt.NDArray[np.floating], other: npt.NDArray[np.floating], peak_n: float) -> float:
    """Return the peak signal-to-noise ratio of `other` against `true`, see `decibels`.

    Parameters
    ----------
    true, other : arrays of float, shape (rows, columns)
        Newtons.
    peak_n : float
        Largest force a taxel can feel, µ.

    Returns
    -------
    float
        Decibels; equal images give 200.
    """
    return float(decibels(np.mean((true.astype(np.float64) - other) ** 2), peak_n))


def adds_noise(sensor_db: float, adc_bits: int) -> bool:
    """Tell whether a sensor of this PSNR does more than round to its ADC's steps: half a step everywhere or less."""
    return sensor_db < 20 * math.log10(2 * ((1 << adc_bits) - 1))


def in_contact(true: npt.NDArray[np.float32], peak_n: float) -> bool:
    """Tell whether a cycle is a contact cycle, by `CONTACT_RATIO`."""
    return float(true.max()) >= CONTACT_RATIO * peak_n


def _near(message: Image | Label, truth: Truth) -> bool:
    return abs(message.sync_mono_ns - truth.sync_mono_ns) < SAME_CYCLE_NS


def _remember(kept: dict[int, Kept], message: Kept) -> None:
    """Keep the newest `REMEMBERED` messages, by counter."""
    kept.pop(message.sync_counter, None)
    kept[message.sync_counter] = message
    while len(kept) > REMEMBERED:
        del kept[next(iter(kept))]
