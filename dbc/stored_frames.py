"""Frames as a recording stores them: fixed records, shorter than `FRAME` on a bus without CAN FD."""

from typing import Final

import numpy as np

from dbc.frame import Frames, frames

#: The record, in words for other programs.
RECORD_TEXT: Final = (
    "time_ns int64 (end of frame, CLOCK_MONOTONIC: the wall clock is wall_offset_ns later), can_id uint32, "
    "length uint8, flags uint8 (1 extended, 2 remote, 4 error, 8 FD, 16 BRS, 32 ESI), 2 bytes 0, "
    "data uint8[data_bytes]; little-endian"
)


def record_type(data_bytes: int) -> np.dtype[np.void]:
    """Return the dtype of a record with `data_bytes` bytes of data."""
    return np.dtype(
        [
            ("time_ns", "<i8"),
            ("can_id", "<u4"),
            ("length", "u1"),
            ("flags", "u1"),
            ("reserved", "<u2"),
            ("data", "u1", (data_bytes,)),
        ]
    )


def to_bytes(arrived: Frames, data_bytes: int) -> bytes:
    """Return frames as records, one after the other."""
    records = np.zeros(len(arrived), record_type(data_bytes))
    for name in ("time_ns", "can_id", "length", "flags"):
        records[name] = arrived[name]
    records["data"] = arrived["data"][:, :data_bytes]
    return records.tobytes()


def from_bytes(content: bytes, data_bytes: int) -> Frames:
    """Return the frames of records; raise ValueError unless the bytes are whole records."""
    records = np.frombuffer(content, record_type(data_bytes))
    made = frames(len(records))
    for name in ("time_ns", "can_id", "length", "flags"):
        made[name] = records[name]
    made["data"][:, :data_bytes] = records["data"]
    return made
