"""Stuff bits of frames, compiled: the stuffing rule is applied to every bit in bus order."""

from typing import Any, Final

import numpy as np
import numpy.typing as npt
from numba import int32, int64, void

from dbc.frame import BRS, CAN_ID_AT, ERROR, ESI, EXTENDED, FD, FD_BYTES, REMOTE
from dbc.frame_bits import DLC, PADDED, fixed_bits
from dbc.frame_fields import ROWS, field
from shell.compiled import njit

#: x^15 + x^14 + x^10 + x^8 + x^7 + x^4 + x^3 + 1 (ISO 11898-1, CRC of classical frames).
CRC_15: Final = 0x4599
_INTS: Final = int32[::1]
#: Flags that decide how many bits a frame has: the first index of `_FIXED_BITS`, the second is its length in bytes.
_KINDS: Final = EXTENDED | REMOTE | FD
_FIXED_BITS: Final = np.stack(fixed_bits(*np.indices((_KINDS + 1, FD_BYTES + 1))), -1)
#: Rows begin with the identifier; the following positions count from there.
_CAN_ID, _LENGTH, _FLAGS, _DATA = 0, 4, 5, 8


@njit(cache=True, nogil=True)
def feed(word: int, width: int, last: int, run: int, stuffed: int) -> tuple[int, int, int]:
    """Apply the stuffing rule to `width` bits of `word`: a stuff bit after each run of five equal bits."""
    for shift in range(width - 1, -1, -1):
        bit = (word >> shift) & 1
        run = run + 1 if bit == last else 1
        last = bit
        if run == 5:
            stuffed += 1
            last, run = 1 - bit, 1  # the stuff bit starts the next run
    return last, run, stuffed


@njit(cache=True, nogil=True)
def feed_crc(word: int, width: int, crc: int) -> int:
    """Continue the CRC-15 over `width` bits of `word`."""
    for shift in range(width - 1, -1, -1):
        feedback = ((word >> shift) ^ (crc >> 14)) & 1
        crc = ((crc << 1) & 0x7FFF) ^ (CRC_15 * feedback)
    return crc


def _octet_tables() -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]:
    """Return what `feed` and `feed_crc` make of each octet.

    The first has, for each last bit and run before (2 * 4) and each octet, the same after it and the stuff bits:
    ``stuffed << 3 | last << 2 | run - 1``. The second has the CRC of each octet.
    """
    fed = [[feed.py_func(octet, 8, state >> 2, (state & 3) + 1, 0) for octet in range(256)] for state in range(8)]
    stuffed = [[stuffed << 3 | last << 2 | run - 1 for last, run, stuffed in of_state] for of_state in fed]
    return np.array(stuffed, np.int32), np.array([feed_crc.py_func(octet, 8, 0) for octet in range(256)], np.int32)


_STUFFED, _CRCS = _octet_tables()


@njit(cache=True, nogil=True)
def feed_octet(octet: int, last: int, run: int, stuffed: int) -> tuple[int, int, int]:
    """Apply the stuffing rule to an octet, as `feed`; not to the first bits of a frame."""
    after = _STUFFED[last << 2 | (run - 1), octet]
    return after >> 2 & 1, (after & 3) + 1, stuffed + (after >> 3)


@njit(cache=True, nogil=True)
def feed_identifier(row: Any, remote: int) -> tuple[int, int]:
    """Return SOF to IDE (standard) or to RTR (extended) as (word, width)."""
    can_id = field(row, _CAN_ID, 4)
    if row[_FLAGS] & EXTENDED:  # SOF 0, base identifier, SRR 1, IDE 1, extension, RTR
        base = (can_id >> 18) & 0x7FF
        return (((base << 2 | 3) << 18 | (can_id & 0x3FFFF)) << 1) | remote, 33
    return ((can_id & 0x7FF) << 2) | (remote << 1), 14


@njit(cache=True, nogil=True)
def count_classic(row: Any) -> int:
    """Count the stuff bits of a classical frame, SOF to the end of the CRC sequence."""
    length = min(int(row[_LENGTH]), 8)
    remote = 1 if row[_FLAGS] & REMOTE else 0
    word, width = feed_identifier(row, remote)
    reserved = 2 if row[_FLAGS] & EXTENDED else 1
    word, width = (word << (reserved + 4)) | length, width + reserved + 4
    whole = width - width % 8
    last, run, stuffed = feed(word >> whole, width % 8, 2, 0, 0)
    crc = feed_crc(word >> whole, width % 8, 0)
    for shift in range(whole - 8, -1, -8):
        octet = word >> shift & 0xFF
        crc = ((crc << 8) & 0x7FFF) ^ _CRCS[(crc >> 7) ^ octet]
        last, run, stuffed = feed_octet(octet, last, run, stuffed)
    if not remote:
        for index in range(length):
            octet = int(row[_DATA + index])
            crc = ((crc << 8) & 0x7FFF) ^ _CRCS[(crc >> 7) ^ octet]
            last, run, stuffed = feed_octet(octet, last, run, stuffed)
    last, run, stuffed = feed(crc >> 8, 7, last, run, stuffed)
    return feed_octet(crc & 0xFF, last, run, stuffed)[2]


@njit(cache=True, nogil=True)
def count_fd(row: Any, dlc: int, wire_length: int) -> tuple[int, int]:
    """Count the dynamic stuff bits of an ISO FD frame before and after the sample point of BRS."""
    flags = row[_FLAGS]
    word, width = feed_identifier(row, 0)
    brs = 1 if flags & BRS else 0
    last, run, nominal = feed(word << 2 | 2, width + 2, 2, 0, 0)  # FDF 1, res 0
    esi = 1 if flags & ESI else 0
    last, run, stuffed = feed(brs << 5 | esi << 4 | dlc, 6, last, run, 0)
    for index in range(wire_length):
        last, run, stuffed = feed_octet(int(row[_DATA + index]), last, run, stuffed)
    if run == 1 and last != last_bit(row, dlc, wire_length):
        stuffed -= 1  # the first fixed stuff bit takes the place of a dynamic one
    return nominal, stuffed


@njit(cache=True, nogil=True)
def last_bit(row: Any, dlc: int, wire_length: int) -> int:
    """Return the last bit before the first fixed stuff bit."""
    return (int(row[_DATA + wire_length - 1]) if wire_length else dlc) & 1


@njit(cache=True, nogil=True)
def count_bits(row: Any) -> tuple[int, int]:
    """Count the bits of a frame at the nominal and at the data bit rate, as `dbc.frame_bits.wire_bits`."""
    flags, length = int(row[_FLAGS]), int(row[_LENGTH])
    if flags & ERROR:
        return 0, 0
    nominal, data = _FIXED_BITS[flags & _KINDS, min(length, FD_BYTES)]
    if not flags & FD:
        return nominal + count_classic(row), 0
    of_head, of_data = count_fd(row, DLC[length], PADDED[length])
    return (nominal + of_head, data + of_data) if flags & BRS else (nominal + of_head + data + of_data, 0)


@njit(void(ROWS, _INTS, _INTS), cache=True, nogil=True)
def count_all(rows: Any, nominal: Any, data: Any) -> None:
    """Write every frame's bits into `nominal` and `data`.

    Parameters
    ----------
    rows : array of uint8, shape (n, bytes of a FRAME)
    nominal, data : arrays of int32, shape (n,)
        Written.
    """
    for index in range(rows.shape[0]):
        nominal[index], data[index] = count_bits(rows[index, CAN_ID_AT:])


@njit(void(ROWS, int64, int64, int64[::1]), cache=True, nogil=True)
def write_times(rows: Any, bitrate: int, data_bitrate: int, times_ns: Any) -> None:
    """Write the time of every frame on the bus into `times_ns`."""
    for index in range(rows.shape[0]):
        times_ns[index] = _time_ns(rows[index, CAN_ID_AT:], bitrate, data_bitrate)


@njit(cache=True, nogil=True)
def time_of_all_ns(rows: Any, bitrate: int, data_bitrate: int) -> int:
    """Return the time of all frames on the bus."""
    busy_ns = 0
    for index in range(rows.shape[0]):
        busy_ns += _time_ns(rows[index, CAN_ID_AT:], bitrate, data_bitrate)
    return busy_ns


@njit(cache=True, nogil=True)
def _time_ns(row: Any, bitrate: int, data_bitrate: int) -> int:
    nominal, data = count_bits(row)
    return int(np.rint((nominal / bitrate + data / data_bitrate) * 1e9))
