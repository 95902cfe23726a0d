"""The protocol between the process of a bus and its clients: packets on a local Unix socket.

The socket is of type SOCK_SEQPACKET, so one packet is one message: a header, then either FRAME records or JSON. A
client sends HELLO and receives WELCOME or REFUSED. After that both sides send FRAMES.
"""

import os
import time
from enum import IntEnum
from pathlib import Path
from struct import Struct
from typing import Final, NamedTuple, TypeVar

import msgspec
import numpy as np
import numpy.typing as npt
from numba import boolean

from bus.error_frames import State
from canskin.errors import UNDECODABLE, InputError
from canskin.session import SOCKET_PATH_MAX, user_folder
from dbc.frame import (
    BRS,
    CAN_ID_AT,
    CLASSIC_BYTES,
    ESI,
    EXTENDED,
    FD,
    FLAGS_AT,
    FRAME,
    LENGTH_AT,
    PORT_AT,
    REMOTE,
    TIME_AT,
    Frames,
    frame_bytes,
)
from dbc.frame_bits import padded_length
from dbc.frame_fields import ROWS, field
from shell.compiled import njit

MAGIC: Final = b"CSK1"
#: Most frames in a packet; a packet must fit a default send buffer.
MAX_FRAMES: Final = 512
#: Most controllers on one connection.
MAX_PORTS: Final = 256
#: magic, kind, state, frames, frames dropped so far, bus time in ns.
HEADER: Final = Struct("<4sBBHQq")
MAX_PAYLOAD: Final = MAX_FRAMES * FRAME.itemsize
MAX_PACKET: Final = HEADER.size + MAX_PAYLOAD

#: Largest start time of a frame, 146 years after the start of the machine: sums of such times fit 64 bits.
LATEST_NS: Final = 1 << 62

_HIGHEST_BASE: Final = 0x7FF
_SENDABLE: Final = EXTENDED | REMOTE | FD | BRS | ESI

Body = TypeVar("Body")


class Kind(IntEnum):
    """What a packet is."""

    HELLO = 1
    WELCOME = 2
    REFUSED = 3
    FRAMES = 4


class Header(NamedTuple):
    """The fixed beginning of every packet; the last three fields are used in FRAMES from the bus."""

    kind: int
    state: int
    frames: int
    dropped: int
    time_ns: int


class Hello(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Request of a client."""

    name: str
    bitrate: int | None = None
    data_bitrate: int | None = None
    fd: bool = False


class Welcome(msgspec.Struct, frozen=True, kw_only=True):
    """Answer of the bus."""

    bitrate: int
    data_bitrate: int | None
    queue_size: int


class ProtocolError(Exception):
    """A packet that violates the protocol."""


def pack(kind: Kind, payload: bytes = b"", *, count: int = 0) -> bytes:
    """Return one packet; the fields that only the bus fills are 0."""
    return HEADER.pack(MAGIC, kind, State.ACTIVE, count, 0, 0) + payload


def unpack(packet: bytes | memoryview) -> tuple[Header, memoryview]:
    """Split a packet; raise ProtocolError unless it begins with a header."""
    if len(packet) < HEADER.size:
        raise ProtocolError(f"a packet of {len(packet)} bytes")
    magic, *fields = HEADER.unpack_from(packet)
    if magic != MAGIC:
        raise ProtocolError(f"a packet that begins with {magic!r}")
    return Header(*fields), memoryview(packet)[HEADER.size :]


def unpack_json(payload: memoryview, body: type[Body]) -> Body:
    """Decode the JSON of a packet; raise ProtocolError unless it is that of a `body`."""
    try:
        return msgspec.json.decode(payload, type=body)
    except UNDECODABLE as error:
        raise ProtocolError(str(error)) from error


def unpack_frames(header: Header, payload: memoryview) -> Frames:
    """Return the records of a FRAMES packet as a view of the packet; raise ProtocolError for a wrong length."""
    if len(payload) != header.frames * FRAME.itemsize:
        raise ProtocolError(f"{len(payload)} bytes for {header.frames} frames")
    return np.frombuffer(payload, FRAME)


def in_time(burst: Frames) -> Frames:
    """Return the leading frames whose latest start (`expires_ns`) has not passed."""
    over = np.flatnonzero((burst["expires_ns"] > 0) & (burst["expires_ns"] < time.monotonic_ns()))
    return burst[: int(over[0])] if len(over) else burst


def check_frames(burst: Frames, *, fd: bool) -> None:
    """Raise InputError, which names the first wrong frame, unless a controller could send the frames."""
    if _are_plain(frame_bytes(burst)):
        return
    flags, length, can_id = burst["flags"], burst["length"], burst["can_id"]
    is_fd = flags & FD != 0
    highest = np.where(flags & EXTENDED, 0x1FFFFFFF, _HIGHEST_BASE)
    longest = np.where(is_fd, 64, CLASSIC_BYTES)
    checks = (
        (flags & ~np.uint8(_SENDABLE) != 0, "flags that only a receiver sees"),
        (can_id > highest, "an identifier that does not fit its format"),
        (length > longest, "more than 8 bytes, or 64 with CAN FD"),
        (is_fd & (flags & REMOTE != 0), "a remote frame of CAN FD, which does not exist"),
        (~is_fd & (flags & (BRS | ESI) != 0), "BRS or ESI without FD"),
        (is_fd & (not fd), "CAN FD on a classical link"),
        (burst["port"] >= MAX_PORTS, f"a port above {MAX_PORTS - 1}"),
        (burst["time_ns"] > LATEST_NS, f"a start time above {LATEST_NS} ns"),
    )
    for is_wrong, words in checks:
        if is_wrong.any():
            place = int(is_wrong.argmax())
            raise InputError(f"frame {place} (identifier 0x{int(can_id[place]):X}) has {words}")


@njit(boolean(ROWS), cache=True, nogil=True)
def _are_plain(rows: npt.NDArray[np.uint8]) -> bool:
    """Tell whether all frames are classical data frames with 11 bits of identifier and nothing wrong: most bursts."""
    for place in range(len(rows)):
        row = rows[place]
        is_plain = row[FLAGS_AT] == 0 and row[LENGTH_AT] <= CLASSIC_BYTES and field(row, CAN_ID_AT, 4) <= _HIGHEST_BASE
        if not is_plain or field(row, PORT_AT, 2) >= MAX_PORTS or field(row, TIME_AT, 8) > LATEST_NS:
            return False
    return True


def padded(burst: Frames) -> Frames:
    """Return the frames with lengths rounded up to lengths that have a DLC; only CAN FD frames change."""
    if burst["flags"].any() and (burst["length"] > CLASSIC_BYTES).any():
        burst = burst.copy()
        burst["length"] = padded_length(burst["length"])
    return burst


def runtime_folder() -> Path:
    """Return the folder of the buses' sockets: SKIN_BUS_DIR, else that of all sockets of this user."""
    chosen = os.environ.get("SKIN_BUS_DIR")
    return Path(chosen) if chosen else user_folder()


def socket_path(channel: str, folder: Path | None = None) -> Path:
    """Return the socket path of the bus `channel`; raise InputError for a name or path that no socket can have."""
    path = (folder or runtime_folder()) / f"{channel}.can"
    if not channel or "/" in channel or channel.startswith("."):
        raise InputError(f"'{channel}' cannot name a bus: expected a word such as bus0")
    if len(os.fsencode(path)) > SOCKET_PATH_MAX:
        raise InputError(f"{path} is too long for a socket: set SKIN_BUS_DIR to a shorter folder")
    return path
