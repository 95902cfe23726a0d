"""Sums ⇄ bytes: raw values of `dbc.packing`, one after another from the lowest bit of the first byte.

This is the order of mapped objects in a PDO (CiA 301, 7.3.4) and of Intel signals in a DBC. A sum never spans two
frames; bits behind the last sum are 0.
"""

import numpy as np
import numpy.typing as npt

from dbc.packing import Packing


def encode(sums: npt.NDArray[np.integer], gather: npt.NDArray[np.intp], packing: Packing) -> npt.NDArray[np.uint8]:
    """Pack sums into payloads.

    Parameters
    ----------
    sums : array of int, shape (m,)
        In ADC counts, within the range of `packing`.
    gather : array of int, shape (frames, width)
        Indices of the sums in each frame; -1 for none.

    Returns
    -------
    array of uint8, shape (frames, ceil(width * bits / 8))
    """
    raw = np.append(packing.raw(sums), np.int32(0))[gather]
    count, width = gather.shape
    if packing.bits == 16:
        return raw.astype("<u2").view(np.uint8).reshape(count, 2 * width)
    if packing.bits == 8:
        return raw.astype(np.uint8)
    bits = np.unpackbits(raw.astype("<u2").view(np.uint8).reshape(count, width, 2), axis=2, bitorder="little")
    return np.packbits(bits[:, :, : packing.bits].reshape(count, width * packing.bits), axis=1, bitorder="little")


def decode(
    payloads: npt.NDArray[np.uint8], gather: npt.NDArray[np.intp], packing: Packing, sums: npt.NDArray[np.int32]
) -> None:
    """Write the sums of `payloads`, shape (frames, bytes), in ADC counts to their places in `sums`, shape (m,)."""
    count, width = gather.shape
    used = payloads[:, : (width * packing.bits + 7) // 8]
    if packing.bits == 16:
        raw = np.ascontiguousarray(used).view("<u2")
    elif packing.bits == 8:
        raw = used
    else:
        bits = np.unpackbits(used, axis=1, bitorder="little")[:, : width * packing.bits]
        raw = np.packbits(bits.reshape(count, width, packing.bits), axis=2, bitorder="little").view("<u2")[:, :, 0]
    there = gather >= 0
    values = raw[there].astype(np.int32)
    if packing.is_signed:
        sign = np.int32(1 << packing.bits - 1)
        values = (values ^ sign) - sign
    sums[gather[there]] = packing.counts(values)
