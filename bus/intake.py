"""Reading the sockets of several links in one compiled call, which waits for frames first.

A link that cannot be read so, as those of python-can, is waited for, too; its owner reads it.
"""

import select
from collections.abc import Sequence
from typing import Any, Final, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numba import int64, types, uint8

from bus.datagrams import Datagrams, new_datagrams, read_datagrams
from bus.link import Link
from bus.protocol import HEADER, MAGIC, MAX_FRAMES, MAX_PACKET, MAX_PORTS, Kind
from bus.told import (
    CAME,
    CLOCK_MONOTONIC,
    DATAGRAMS,
    DESCRIPTOR,
    DONTWAIT,
    DROPPED,
    HAS_FAILED,
    IS_READY,
    NEEDS_LOOK,
    PACKETS,
    READER,
    RETURNED,
    SECOND_NS,
    STATE,
    clock_ns,
    has_failed,
)
from dbc.frame import ECHO, FLAGS_AT, FRAME, PORT_AT, Frames
from dbc.frame_fields import ROWS, Bytes, Integers, field
from shell.compiled import njit

#: Frames of a link in one call.
MOST_FRAMES: Final = 16 * MAX_FRAMES

_MAGIC: Final = int.from_bytes(MAGIC, "little")
_HEADER_BYTES, _FRAME_BYTES = HEADER.size, FRAME.itemsize
#: Where `HEADER` has state, frames and dropped frames.
_KIND_AT, _STATE_AT, _FRAMES_AT, _DROPPED_AT = 4, 5, 6, 8
_FRAMES: Final = int(Kind.FRAMES)
_POLLIN: Final = int(select.POLLIN)

_nanosleep: Any = types.ExternalFunction("nanosleep", types.int32(types.intp, types.intp))
_ppoll: Any = types.ExternalFunction("ppoll", types.int32(types.intp, types.uint64, types.intp, types.intp))
_send: Any = types.ExternalFunction("send", types.intp(types.int32, types.intp, types.uint64, types.int32))
_recv: Any = types.ExternalFunction("recv", types.intp(types.int32, types.intp, types.uint64, types.int32))


@runtime_checkable
class Readable(Protocol):
    """A link whose socket is read by `read_links`."""

    def tell(self, told: Integers) -> None:
        """Use `told` for what is told of the link from now on."""

    def arrived(self, rows: Bytes) -> Frames:
        """Return the frames that were read into `rows`, and use what was told besides."""
        ...


class Intake(NamedTuple):
    """What is read of some links, and room for the reading.

    Attributes
    ----------
    told : array of int64, shape (links, RETURNED + MAX_PORTS)
    rows : array of uint8, shape (links, MOST_FRAMES, bytes of a FRAME)
        The frames that were read, in bus order.
    polls, span : arrays of int64
        ``struct pollfd`` of each link, and a ``struct timespec``.
    packet : array of uint8
        Room for a packet of `bus.protocol`.
    datagrams : Datagrams
        Room of each link for datagrams, whose frames come into `rows`.
    """

    told: Integers
    rows: Bytes
    polls: Integers
    span: Integers
    packet: Bytes
    datagrams: Datagrams


def new_intake(links: int) -> Intake:
    """Return the room for some links, of which none is there yet."""
    told = np.zeros((links, RETURNED + MAX_PORTS), np.int64)
    told[:, DESCRIPTOR] = -1
    rows = np.empty((links, MOST_FRAMES, _FRAME_BYTES), np.uint8)
    polls, span, packet = np.zeros(links, np.int64), np.zeros(2, np.int64), np.empty(MAX_PACKET, np.uint8)
    return Intake(told, rows, polls, span, packet, new_datagrams(rows))


def attach(links: Sequence[Link], intake: Intake) -> None:
    """Have links read by `read_links`, as far as they can be, and waited for."""
    for link, told in zip(links, intake.told, strict=True):
        if isinstance(link, Readable):
            link.tell(told)
        else:
            told[DESCRIPTOR] = link.fileno()


@njit(cache=True, nogil=True)
def read_links(rest_ns: int, wait_ns: int, intake: Intake) -> None:
    """Rest, wait until a link is readable, and read all that are; at most for `wait_ns`, the rest included."""
    told, span, polls = intake.told, intake.span, intake.polls
    ends_ns = clock_ns(CLOCK_MONOTONIC, span) + wait_ns
    if rest_ns > 0:
        span[0], span[1] = rest_ns // SECOND_NS, rest_ns % SECOND_NS
        _nanosleep(span.ctypes.data, 0)
    wait_ns = max(0, ends_ns - clock_ns(CLOCK_MONOTONIC, span))
    for link in range(polls.size):
        polls[link] = (told[link, DESCRIPTOR] & 0xFFFFFFFF) | _POLLIN << 32
        told[link, CAME] = told[link, IS_READY] = told[link, NEEDS_LOOK] = 0
    span[0], span[1] = wait_ns // SECOND_NS, wait_ns % SECOND_NS
    if _ppoll(polls.ctypes.data, polls.size, span.ctypes.data, 0) <= 0:
        return
    for link in range(polls.size):
        told[link, IS_READY] = polls[link] >> 48 != 0
        if told[link, IS_READY] and told[link, READER] == PACKETS:
            read_packets(told[link], intake.rows[link], intake.packet)
        elif told[link, IS_READY] and told[link, READER] == DATAGRAMS:
            messages, parts = intake.datagrams
            read_datagrams(told[link], intake.rows[link], messages[link], parts[link], span)


@njit(cache=True, nogil=True)
def read_packets(told: Integers, rows: Bytes, packet: Bytes) -> None:
    """Read all packets of `bus.protocol` that wait in a socket; a wrong one is as a failure of the socket."""
    count = 0
    while count + MAX_FRAMES <= rows.shape[0]:
        size = _recv(told[DESCRIPTOR], packet.ctypes.data, packet.size, DONTWAIT)
        if size < 0:
            told[HAS_FAILED] = has_failed()
            break
        frames = field(packet, _FRAMES_AT, 2)
        if size != _HEADER_BYTES + frames * _FRAME_BYTES or field(packet, 0, 4) != _MAGIC:
            told[HAS_FAILED] = True
            break
        told[STATE], told[DROPPED] = packet[_STATE_AT], field(packet, _DROPPED_AT, 8)
        for place in range(frames):
            row, begin = rows[count + place], _HEADER_BYTES + place * _FRAME_BYTES
            row[:] = packet[begin : begin + _FRAME_BYTES]
            if row[FLAGS_AT] & ECHO:
                told[RETURNED + field(row, PORT_AT, 2) % MAX_PORTS] += 1
        count += frames
    told[CAME] = count


@njit(int64(ROWS, int64, int64[::1], int64[::1], uint8[::1]), cache=True, nogil=True)
def send_packet(rows: Bytes, queue_size: int, told: Integers, sent: Integers, packet: Bytes) -> int:
    """Send the leading frames for which the transmit queues have room, one packet at most; return how many were sent.

    Parameters
    ----------
    sent : array of int64, shape (MAX_PORTS,)
        Frames sent so far by port, of which those that are not in `told` are in a queue.

    Returns
    -------
    int
        0 if there is no room now, -1 if the socket has failed.
    """
    frames = 0
    for place in range(min(len(rows), MAX_FRAMES)):
        row, begin = rows[place], _HEADER_BYTES + place * _FRAME_BYTES
        port = field(row, PORT_AT, 2)
        if sent[port] - told[RETURNED + port] >= queue_size:
            break
        sent[port] += 1
        for byte in range(_FRAME_BYTES):
            packet[begin + byte] = row[byte]
        frames += 1
    if not frames:
        return 0
    size = _HEADER_BYTES + frames * _FRAME_BYTES
    packet[:_HEADER_BYTES] = 0
    for byte in range(4):
        packet[byte] = _MAGIC >> 8 * byte & 0xFF
    packet[_KIND_AT], packet[_FRAMES_AT], packet[_FRAMES_AT + 1] = _FRAMES, frames & 0xFF, frames >> 8
    if _send(told[DESCRIPTOR], packet.ctypes.data, size, DONTWAIT) == size:
        return frames
    failed = has_failed()
    for place in range(frames):
        sent[field(rows[place], PORT_AT, 2)] -= 1
    return -int(failed)
