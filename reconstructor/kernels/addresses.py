"""The order of the pixels of a tactile image in the compiled solvers.

A level of a Haar transform combines even and odd pixels. When the lowest bit of a pixel's index becomes the highest bit
of its address, these pixels are half an array apart, and every level is a loop over contiguous memory. The reordering
needs no extra time, because the taxels go through the permutation of Φ in any case.
"""

import numpy as np
import numpy.typing as npt

Indices = npt.NDArray[np.intp]


def pyramid_levels(rows: int, columns: int) -> int:
    """Return the number of levels of the pyramid: until the shorter side is one pixel."""
    return min(rows, columns).bit_length() - 1


def pyramid_addresses(rows: int, columns: int) -> Indices:
    """Return each pixel's address for the pyramid, shape (rows, columns), a permutation of 0 … n-1.

    The address bits are, highest first, ``i0 j0 i1 j1 …`` of row i and column j, then the other bits of the longer
    side.
    """
    row, column = np.indices((rows, columns))
    address = np.zeros((rows, columns), np.intp)
    for level in range(pyramid_levels(rows, columns)):
        address = 4 * address + 2 * (row >> level & 1) + (column >> level & 1)
    levels = pyramid_levels(rows, columns)
    rest = (row >> levels) + (column >> levels)  # one of the two terms is 0
    return address * (max(rows, columns) >> levels) + rest


def tensor_addresses(rows: int, columns: int) -> Indices:
    """Return each pixel's address for the tensor transform, shape (rows, columns): bits of row and column reversed."""
    return _reversed_bits(rows)[:, None] * columns + _reversed_bits(columns)[None, :]


def row_addresses(rows: int, columns: int) -> Indices:
    """Return each pixel's address row by row, shape (rows, columns)."""
    return np.arange(rows * columns).reshape(rows, columns)


def shifted(addresses: Indices, shift: tuple[int, int]) -> Indices:
    """Return the addresses of an image moved by `shift` (down, right), circularly."""
    return np.roll(addresses, (-shift[0], -shift[1]), axis=(0, 1))


def spin_shifts(count: int, rows: int, columns: int) -> list[tuple[int, int]]:
    """Return `count` different shifts, beginning with (0, 0); any few consecutive shifts are evenly spread.

    The points of a Hammersley-like set on an 8 x 8 grid. Longer shifts would change coarse coefficients only.
    """
    side = 1 << min(8, rows, columns).bit_length() - 1
    backwards = _reversed_bits(side)
    order = [(int(backwards[k % side]), int(backwards[(k // side + k) % side])) for k in range(side * side)]
    return order[:count]


def _reversed_bits(size: int) -> Indices:
    """Return 0 … size-1 with their bits in reversed order; `size` is a power of two."""
    values = np.zeros(1, np.intp)
    while values.size < size:
        values = np.concatenate((2 * values, 2 * values + 1))
    return values
