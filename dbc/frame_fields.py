"""Numbers in the records of frames, for compiled code."""

from typing import Any, Final

import numpy as np
import numpy.typing as npt
from numba import types, uint8

from shell.compiled import njit

#: Records as rows of bytes; kernels that are compiled for these take every array of frames, at once.
ROWS: Final = types.Array(uint8, 2, "A", readonly=True)

Integers = npt.NDArray[np.int64]
Bytes = npt.NDArray[np.uint8]
Flags = npt.NDArray[np.bool_]


@njit(cache=True, nogil=True)
def field(row: Any, first: int, count: int) -> int:
    """Return the little-endian number of `count` bytes from byte `first` of a record on."""
    value = np.int64(0)
    for byte in range(count):
        value |= np.int64(row[first + byte]) << np.int64(8 * byte)
    return int(value)
