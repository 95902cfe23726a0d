"""Sums ⇄ bytes: the payload of a TPDO is up to four INTEGER16, little-endian (CiA 301, 7.1.4.2)."""

import numpy as np
import numpy.typing as npt

from dbc.contract import FRAME_BYTES


def encode(sums: npt.NDArray[np.int16], gather: npt.NDArray[np.intp]) -> npt.NDArray[np.uint8]:
    """Pack sums into payloads.

    Parameters
    ----------
    sums : array of int16, shape (m,)
    gather : array of int, shape (frames, 4)
        Which sums each frame carries; -1 for none.

    Returns
    -------
    array of uint8, shape (frames, 8); bytes without a sum are 0
    """
    padded = np.append(sums, np.int16(0)).astype("<i2")
    return padded[gather].view(np.uint8).reshape(-1, FRAME_BYTES)


def decode(payloads: npt.NDArray[np.uint8], gather: npt.NDArray[np.intp], sums: npt.NDArray[np.int32]) -> None:
    """Write the sums of `payloads`, shape (frames, 8), to their places in `sums`, shape (m,)."""
    values = payloads[:, :FRAME_BYTES].copy().view("<i2")
    there = gather >= 0
    sums[gather[there]] = values[there]
