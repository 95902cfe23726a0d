"""Sums ⇄ bytes: the SYNC counter, then raw values of `dbc.packing`, one after another from the lowest bit on.

This is the order of mapped objects in a PDO (CiA 301, 7.3.4) and of Intel signals in a DBC. A sum never spans two
frames; bits behind the last sum are 0.
"""

import numpy as np
import numpy.typing as npt

from dbc.packing import COUNTER_BYTES, Packing
from shell.compiled import njit


def encode(
    sync_counter: int, sums: npt.NDArray[np.integer], gather: npt.NDArray[np.intp], packing: Packing
) -> npt.NDArray[np.uint8]:
    """Pack sums of one cycle into payloads.

    Parameters
    ----------
    sync_counter : int
        Of the SYNC at which they were sampled; 0 for a SYNC without counter.
    sums : array of int, shape (m,)
        In ADC counts, within the range of `packing`.
    gather : array of int, shape (frames, width)
        Indices of the sums in each frame; -1 for none.

    Returns
    -------
    array of uint8, shape (frames, 1 + ceil(width * bits / 8))
    """
    packed = packed_values(np.append(packing.raw(sums), np.int32(0))[gather], packing.bits)
    payloads = np.full((len(packed), COUNTER_BYTES + packed.shape[1]), sync_counter, np.uint8)
    payloads[:, COUNTER_BYTES:] = packed
    return payloads


def packed_values(raw: npt.NDArray[np.integer], bits: int) -> npt.NDArray[np.uint8]:
    """Return the bytes of rows of integers of `bits` bits, shape (frames, width): (frames, ceil(width * bits / 8))."""
    count, width = raw.shape
    spread = np.unpackbits(raw.astype("<u2").view(np.uint8).reshape(count, width, 2), axis=2, bitorder="little")
    return np.packbits(spread[:, :, :bits].reshape(count, width * bits), axis=1, bitorder="little")


def decode(
    payloads: npt.NDArray[np.uint8], gather: npt.NDArray[np.intp], packing: Packing, sums: npt.NDArray[np.int32]
) -> None:
    """Write the sums of `payloads`, shape (frames, bytes), in ADC counts to their places in `sums`, shape (m,)."""
    raw = np.zeros(len(sums), np.int32)
    _read_all(np.ascontiguousarray(payloads), gather, packing.bits, packing.is_signed, raw)
    there = gather[gather >= 0]
    sums[there] = packing.counts(raw[there])


@njit(cache=True, nogil=True)
def read_raw(
    payload: npt.NDArray[np.uint8], places: npt.NDArray[np.intp], bits: int, is_signed: bool, raw: npt.NDArray[np.int32]
) -> None:
    """Write the raw values of one payload to their places in `raw`, shape (m,); a place of -1 is of no sum."""
    sign = 1 << (bits - 1)
    for index in range(len(places)):
        if places[index] < 0:
            continue
        first, shift = divmod(8 * COUNTER_BYTES + index * bits, 8)
        word = 0
        for byte in range((shift + bits + 7) // 8):
            word |= int(payload[first + byte]) << (8 * byte)
        value = (word >> shift) & ((1 << bits) - 1)
        raw[places[index]] = (value ^ sign) - sign if is_signed else value


@njit(cache=True, nogil=True)
def _read_all(
    payloads: npt.NDArray[np.uint8],
    gather: npt.NDArray[np.intp],
    bits: int,
    is_signed: bool,
    raw: npt.NDArray[np.int32],
) -> None:
    for frame in range(len(payloads)):
        read_raw(payloads[frame], gather[frame], bits, is_signed, raw)
