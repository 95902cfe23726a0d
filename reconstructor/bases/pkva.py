"""The filters of the contourlet, all from 'pkva': ladder filters, and filter pair of the Laplacian pyramid.

PyWavelets has none of them.
"""

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

Matrix = npt.NDArray[np.float64]

_HALF = np.array((0.6300, -0.1930, 0.0972, -0.0526, 0.0272, -0.0144))
#: The 12 taps of Phoong, Kim, Vaidyanathan and Ansari (1995), half a sample from the middle.
PKVA: Final = np.concatenate((_HALF[::-1], _HALF))
#: The same modulated for the fan filters of the directional bank.
FAN: Final = PKVA * np.tile((-1.0, 1.0), 6)
ROOT_TWO: Final = 2**0.5


class PyramidPair(NamedTuple):
    """Periodic filters of one pyramid level as matrices.

    Attributes
    ----------
    down : shape (size / 2, size)
        Filter, then keep every second sample.
    up : shape (size, size / 2)
        Put zeros between samples, then filter. ``down @ up`` is the identity.
    """

    down: Matrix
    up: Matrix


def pyramid_pair(size: int) -> PyramidPair:
    """Return the pyramid filters for one side of the image."""
    low, high = _pkva_pair()
    return PyramidPair(_circulant(low, size)[::2], _circulant(high, size)[:, ::2])


def _pkva_pair() -> tuple[Matrix, Matrix]:
    """Return h = √2 (δ + B) / 2 and g = √2 (δ - B (δ + B) / 2), odd offsets of g negated.

    B is PKVA with zeros between its taps.
    """
    spread = np.zeros(23)
    spread[::2] = PKVA
    half = spread / 2
    half[11] += 0.5
    high = -np.convolve(spread, half)
    high[22] += 1
    high[1::2] *= -1  # offset 0 is index 22
    return ROOT_TWO * half, ROOT_TWO * high


def _circulant(taps: Matrix, size: int) -> Matrix:
    """Return the matrix of periodic filtering by symmetric `taps` of odd length."""
    matrix = np.zeros((size, size))
    for place, tap in enumerate(taps, start=-(len(taps) // 2)):
        matrix[np.arange(size), (np.arange(size) + place) % size] += tap
    return matrix
