"""Permutations of the contourlet's directional filter bank (Bamberger and Smith; Do and Vetterli 2005).

A level of the bank splits every band into two polyphase components and filters them with the ladder of Phoong, Kim,
Vaidyanathan and Ansari (1995). The split (shears, every second row or column, shears) only moves samples. So the bank
is a chain: permutation, ladder, permutation, ladder, …, permutation. This module computes the permutations. Positions
follow the MATLAB contourlet toolbox, with all indices modulo the size.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

Indices = npt.NDArray[np.intp]


class Level(NamedTuple):
    """One level: take samples by `gather`, then one ladder on both halves of the result.

    Attributes
    ----------
    gather : shape (n,)
        The first half are the components p0 of all bands, the second half p1.
    bands, rows, columns : int
        Each half is an array (bands, rows, columns); tall bands are stored transposed.
    quincunx : bool
        True on the first level: samples that leave at the top or bottom enter shifted by half the width.
    """

    gather: Indices
    bands: int
    rows: int
    columns: int
    quincunx: bool


def bank(size: int, levels: int) -> tuple[list[Level], Indices]:
    """Return the levels for a square image, and the gather that brings the result into the toolbox's order.

    Parameters
    ----------
    size : int
        Rows and columns, a power of two of at least ``2 ** (levels - 1)``.
    levels : int
        From 2; there are ``2 ** levels`` bands.
    """
    made = []
    images = [np.arange(size * size).reshape(size, size)]
    for number in range(1, levels + 1):
        count = len(images)
        parted = [_part(image, number, k, count) for k, image in enumerate(images)]
        lying = [_lying(pair[half], k, number, count) for half in (0, 1) for k, pair in enumerate(parted)]
        gather = np.concatenate([part.ravel() for part in lying])
        rows, columns = lying[0].shape
        made.append(Level(gather, count, rows, columns, quincunx=number == 1))
        images = _channels(made[-1], number)
    return made, np.concatenate([band.ravel() for band in _ordered(images, levels)])


def _shear(image: Indices, kind: int, amount: int = 1) -> Indices:
    """Return the image with row i moved by i, or column j by j: kinds R1 to R4 of the toolbox."""
    rows, columns = image.shape
    i, j = np.indices(image.shape)
    sign = amount if kind in {1, 3} else -amount
    moved: Indices = image[(i + sign * j) % rows, j] if kind < 3 else image[i, (j + sign * i) % columns]
    return moved


def _split_rows(image: Indices, *, turned: bool, back: int) -> tuple[Indices, Indices]:
    """Part even and odd rows, the odd ones `turned` left by one sample, and shear both back."""
    odd = np.roll(image[1::2], -1, axis=1) if turned else image[1::2]
    return _shear(image[::2], back), _shear(odd, back)


def _split_columns(image: Indices, *, turned: bool, back: int) -> tuple[Indices, Indices]:
    odd = np.roll(image[:, 1::2], -1, axis=0) if turned else image[:, 1::2]
    return _shear(image[:, ::2], back), _shear(odd, back)


def _part(image: Indices, number: int, k: int, count: int) -> tuple[Indices, Indices]:
    """Return the polyphase components of band `k` of `count` on level `number`."""
    if number == 1:
        return _split_rows(_shear(image, 2), turned=True, back=3)
    if number == 2:
        return _split_columns(_shear(image, 4), turned=True, back=1)
    first = k % 2 == 0
    if k < count // 2:
        return _split_rows(image, turned=first, back=3 if first else 4)
    return _split_columns(image, turned=first, back=1 if first else 2)


def _lying(image: Indices, k: int, number: int, count: int) -> Indices:
    return image.T if number > 2 and k >= count // 2 else image


def _channels(level: Level, number: int) -> list[Indices]:
    """Return the index images of the ladder's outputs, in the order the next level takes them."""
    halves = np.arange(2 * level.bands * level.rows * level.columns).reshape(2, level.bands, level.rows, level.columns)
    images = []
    for k in range(level.bands):
        low, high = (_lying(half[k], k, number, level.bands) for half in halves)
        images += [low, high] if number == 1 else [high, low]
    return images


def _ordered(images: list[Indices], levels: int) -> list[Indices]:
    """Shear every band back to a rectangular grid, and reverse the second half of the bands."""
    pairs = len(images) // 4
    if levels < 3:
        return images[:2] + images[:1:-1]
    half = len(images) // 2
    made = [
        _shear(image, 3 if k < half else 1, 2 * (k % half // 2 + 1) - (pairs + 1)) for k, image in enumerate(images)
    ]
    return made[:half] + made[: half - 1 : -1]
