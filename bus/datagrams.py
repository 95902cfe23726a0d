"""Frames of SocketCAN's sockets, many in a system call: recvmmsg(2) and sendmmsg(2) from compiled code.

A frame of the kernel is a FRAME without its times (``struct canfd_frame``, whose first 16 bytes are ``struct
can_frame``), so the kernel writes received frames to their places.
"""

from typing import Any, Final, NamedTuple

import numpy as np
from numba import int64, types

from bus.told import (
    CAME,
    CLOCK_MONOTONIC,
    CLOCK_REALTIME,
    DESCRIPTOR,
    DEVICE_ERROR,
    DONTWAIT,
    DROPPED,
    HAS_FAILED,
    NEEDS_LOOK,
    NO_STAMPS,
    OFFSET,
    SECOND_NS,
    STAMP_ERROR,
    clock_ns,
    has_failed,
)
from dbc.canopen import SYNC_COB_ID
from dbc.frame import BRS, CAN_ID_AT, DATA_AT, ECHO, ERROR, ESI, EXTENDED, FD, FLAGS_AT, FRAME, LENGTH_AT, REMOTE
from dbc.frame_fields import ROWS, Bytes, Integers, field
from shell.clock import READINGS
from shell.compiled import njit

#: Most datagrams in a call.
MOST_DATAGRAMS: Final = 256
#: ``struct can_frame``, and ``struct canfd_frame``.
CLASSIC_WIRE, FD_WIRE = 16, FRAME.itemsize - CAN_ID_AT
SO_TIMESTAMPNS: Final = 35
SO_TIMESTAMPING: Final = 37
SO_RXQ_OVFL: Final = 40
#: Flags of SO_TIMESTAMPING: raw stamps of the device alone; the kernel's come by SO_TIMESTAMPNS.
DEVICE_STAMPS: Final = 1 << 2 | 1 << 6

#: Words of ``struct mmsghdr`` (``struct msghdr`` and the length of the datagram).
_MESSAGE_WORDS: Final = 8
_VECTORS, _VECTOR_COUNT, _CONTROL, _CONTROL_SIZE, _MESSAGE_FLAGS, _SIZE = 2, 3, 4, 5, 6, 7
#: Words of ``struct iovec``, before the control data: time stamps of the kernel (timespec) and of the device (three
#: of them), and a drop count, each after a ``struct cmsghdr``.
_BASE, _ROOM, _VECTOR_WORDS, _CONTROL_WORDS = 0, 1, 2, 16
_HEADER_BYTES: Final = 16
#: Words of a FRAME: the third has identifier, length, flags and port, from the lowest bits on.
_TIME, _EXPIRES, _HEAD, _DATA = range(4)
_LENGTH_BIT, _FLAGS_BIT = 8 * (LENGTH_AT - CAN_ID_AT), 8 * (FLAGS_AT - CAN_ID_AT)
#: Flags of the kernel, in the identifier and in the flags of a frame, and that of the flags of a datagram that this
#: socket sent.
_EFF, _RTR, _ERR = 0x80000000, 0x40000000, 0x20000000
_FD_BRS, _FD_ESI = 0x01, 0x02
_MSG_CONFIRM: Final = 0x800

_recvmmsg: Any = types.ExternalFunction(
    "recvmmsg", types.int32(types.int32, types.intp, types.uint32, types.int32, types.intp)
)
_sendmmsg: Any = types.ExternalFunction("sendmmsg", types.int32(types.int32, types.intp, types.uint32, types.int32))


class Datagrams(NamedTuple):
    """Headers of datagrams for the system calls, of several sockets.

    Attributes
    ----------
    messages : array of int64, shape (sockets, MOST_DATAGRAMS, 8)
        ``struct mmsghdr`` of each datagram.
    parts : array of int64, shape (sockets, MOST_DATAGRAMS, 18)
        ``struct iovec`` of each datagram, and its control data.
    """

    messages: Integers
    parts: Integers


def new_datagrams(rows: Bytes) -> Datagrams:
    """Return the headers of datagrams whose frames are in `rows`, shape (sockets, at least MOST_DATAGRAMS, FRAME)."""
    messages = np.zeros((len(rows), MOST_DATAGRAMS, _MESSAGE_WORDS), np.int64)
    parts = np.zeros((len(rows), MOST_DATAGRAMS, _VECTOR_WORDS + _CONTROL_WORDS), np.int64)
    parts[..., _BASE], parts[..., _ROOM] = _places(rows) + CAN_ID_AT, FD_WIRE
    messages[..., _VECTORS], messages[..., _VECTOR_COUNT] = _places(parts), 1
    messages[..., _CONTROL], messages[..., _CONTROL_SIZE] = _places(parts) + 8 * _VECTOR_WORDS, 8 * _CONTROL_WORDS
    return Datagrams(messages, parts)


def _places(rows: Any) -> Integers:
    """Return the addresses of rows, shape (sockets, MOST_DATAGRAMS)."""
    of_sockets, of_rows = rows.strides[0] * np.arange(len(rows)), rows.strides[1] * np.arange(MOST_DATAGRAMS)
    places: Integers = rows.ctypes.data + np.add.outer(of_sockets, of_rows)
    return places


@njit(cache=True, nogil=True)
def read_datagrams(told: Integers, rows: Bytes, messages: Integers, parts: Integers, span: Integers) -> None:
    """Read the frames that wait in a socket into `rows`; `span` is room for a ``struct timespec``."""
    offset_ns, error_ns = 0, 1 << 62
    for _ in range(READINGS):
        before_ns, wall_ns = clock_ns(CLOCK_MONOTONIC, span), clock_ns(CLOCK_REALTIME, span)
        after_ns = clock_ns(CLOCK_MONOTONIC, span)
        if (after_ns - before_ns) // 2 < error_ns:
            offset_ns, error_ns = wall_ns - (before_ns + after_ns) // 2, (after_ns - before_ns) // 2 + 1
    came = _recvmmsg(told[DESCRIPTOR], messages.ctypes.data, len(messages), DONTWAIT, 0)
    if came > 0:
        now_ns = clock_ns(CLOCK_MONOTONIC, span)
        told[STAMP_ERROR] = error_ns + abs(offset_ns - told[OFFSET]) + told[DEVICE_ERROR]
        told[OFFSET] = offset_ns
        decode(came, now_ns, told, rows.view(np.int64), messages, parts)
    else:
        told[HAS_FAILED] = came < 0 and has_failed()


@njit(cache=True, nogil=True)
def decode(  # noqa: PLR0917  compiled functions take no keywords
    came: int, now_ns: int, told: Integers, words: Integers, messages: Integers, parts: Integers
) -> None:
    """Make records of datagrams that have come, each at its place in `words`; `now_ns` is for frames without stamp.

    The echo of SYNC keeps the time stamp of the device, on a clock of its own, in place of `expires_ns`.
    """
    count = 0
    for place in range(came):
        stamp_ns, device_ns, dropped = _read_control(parts[place, _VECTOR_WORDS:], messages[place, _CONTROL_SIZE])
        messages[place, _CONTROL_SIZE] = 8 * _CONTROL_WORDS
        told[DROPPED] = max(told[DROPPED], dropped)
        size, frame = messages[place, _SIZE] & 0xFFFFFFFF, words[count]
        if size not in (CLASSIC_WIRE, FD_WIRE):
            continue
        count += 1
        if count <= place:
            frame[:] = words[place]
        can_id, length = frame[_HEAD] & 0xFFFFFFFF, frame[_HEAD] >> _LENGTH_BIT & 0xFF
        flags = (can_id & _EFF != 0) * EXTENDED | (can_id & _RTR != 0) * REMOTE | (can_id & _ERR != 0) * ERROR
        flags |= (messages[place, _MESSAGE_FLAGS] & _MSG_CONFIRM != 0) * ECHO
        if size == FD_WIRE:
            kind = frame[_HEAD] >> _FLAGS_BIT
            flags |= FD | (kind & _FD_BRS != 0) * BRS | (kind & _FD_ESI != 0) * ESI
        can_id &= 0x1FFFFFFF if flags & (EXTENDED | ERROR) else 0x7FF
        length = min(length, 64 if size == FD_WIRE else 8)
        is_timed = can_id == SYNC_COB_ID and flags & ~(FD | BRS | ESI) == ECHO and device_ns > 0
        frame[_TIME] = stamp_ns - told[OFFSET] if stamp_ns > 0 else now_ns
        frame[_EXPIRES] = device_ns if is_timed else 0
        frame[_HEAD] = can_id | length << _LENGTH_BIT | flags << _FLAGS_BIT
        # The room is used again: the bytes after a frame's data belong to an older frame.
        for word in range(_DATA, frame.size):
            left = 0 if flags & REMOTE else length - 8 * (word - _DATA)
            if left < 8:
                frame[word] &= (1 << 8 * max(left, 0)) - 1
        if stamp_ns == 0:
            told[STAMP_ERROR] = NO_STAMPS
        told[NEEDS_LOOK] |= stamp_ns == 0 or is_timed or flags & ERROR != 0
    told[CAME] = count


@njit(cache=True, nogil=True)
def _read_control(control: Integers, size: int) -> tuple[int, int, int]:
    """Return the time stamps of the kernel and of the device, and the drop count; 0 without."""
    stamp_ns, device_ns, dropped, place = 0, 0, 0, 0
    while 8 * place + _HEADER_BYTES <= size and _HEADER_BYTES <= control[place] <= size - 8 * place:
        kind = control[place + 1] >> 32
        if kind == SO_TIMESTAMPNS:
            stamp_ns = control[place + 2] * SECOND_NS + control[place + 3]
        elif kind == SO_TIMESTAMPING:  # struct scm_timestamping: the third is the device's
            device_ns = control[place + 6] * SECOND_NS + control[place + 7]
        elif kind == SO_RXQ_OVFL:
            dropped = control[place + 2] & 0xFFFFFFFF
        place += (control[place] + 7) // 8
    return stamp_ns, device_ns, dropped


_WORDS: Final = int64[:, ::1]


@njit(int64(int64, ROWS, _WORDS, _WORDS, _WORDS), cache=True, nogil=True)
def send_datagrams(descriptor: int, rows: Bytes, words: Integers, messages: Integers, parts: Integers) -> int:
    """Send the leading frames that the socket takes; return their number, -1 if the socket has failed.

    Parameters
    ----------
    words : array of int64
        Room for the frames of `messages`, as words.
    """
    count = min(len(rows), len(messages))
    for place in range(count):
        row, frame = rows[place], words[place]
        flags, can_id = row[FLAGS_AT], field(row, CAN_ID_AT, 4)
        can_id |= (flags & EXTENDED != 0) * _EFF | (flags & REMOTE != 0) * _RTR
        kind = (flags & BRS != 0) * _FD_BRS | (flags & ESI != 0) * _FD_ESI
        frame[_HEAD] = can_id | np.int64(row[LENGTH_AT]) << _LENGTH_BIT | kind << _FLAGS_BIT
        for word in range(_DATA, frame.size):
            frame[word] = field(row, DATA_AT + 8 * (word - _DATA), 8)
        parts[place, _ROOM] = FD_WIRE if flags & FD else CLASSIC_WIRE
        messages[place, _CONTROL] = messages[place, _CONTROL_SIZE] = 0
    sent = _sendmmsg(descriptor, messages.ctypes.data, count, DONTWAIT)
    return sent if sent >= 0 else -int(has_failed())
