"""Conversion between python-can's messages and FRAME records."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from dbc.frame import BRS, ECHO, ERROR, ESI, EXTENDED, FD, REMOTE, Frames, frames

if TYPE_CHECKING:
    import can

#: An error frame in a log of candump has this flag in its identifier (CAN_ERR_FLAG of SocketCAN).
CANDUMP_ERROR: Final = 0x20000000
_FLAG_OF: Final = (
    ("is_extended_id", EXTENDED),
    ("is_remote_frame", REMOTE),
    ("is_error_frame", ERROR),
    ("is_fd", FD),
    ("bitrate_switch", BRS),
    ("error_state_indicator", ESI),
)


def to_message(record: np.void, channel: str, offset_ns: int) -> "can.Message":
    """Convert a record to a message; the time stamp is in seconds since the epoch."""
    import can  # no verb waits for python-can that has no need of it

    flags, length = int(record["flags"]), int(record["length"])
    message = can.Message(
        timestamp=(int(record["time_ns"]) + offset_ns) * 1e-9,
        arbitration_id=int(record["can_id"]),
        channel=channel,
        dlc=length,
        data=None if flags & REMOTE else record["data"][:length].tobytes(),
        is_rx=not flags & ECHO,
    )
    for name, flag in _FLAG_OF:
        setattr(message, name, bool(flags & flag))
    return message


def to_frame(message: "can.Message", time_ns: int) -> Frames:
    """Convert a message to one record, with a time in place of its own."""
    return _records([message], [time_ns])


def to_logged_frames(messages: "Sequence[can.Message]") -> Frames:
    """Convert the messages of a log to records, with the time stamps of the log."""
    return _records(messages, [round(message.timestamp * 1e9) for message in messages])


def _records(messages: "Sequence[can.Message]", times_ns: list[int]) -> Frames:
    many = frames(len(messages))
    many["time_ns"] = times_ns
    many["can_id"] = [message.arbitration_id for message in messages]
    many["flags"] = [flags_of(message) for message in messages]
    many["length"] = [message.dlc for message in messages]
    padded = b"".join(bytes(message.data or b"")[:64].ljust(64, b"\0") for message in messages)
    many["data"] = np.frombuffer(padded, np.uint8).reshape(len(messages), 64)
    return many


def flags_of(message: "can.Message") -> int:
    """Return the flags of the record of a message."""
    return sum(flag for name, flag in _FLAG_OF if getattr(message, name))
