"""One CAN frame as a record of an array, so that a burst is one array and not hundreds of objects."""

from typing import Final

import numpy as np
import numpy.typing as npt

#: 29-bit identifier (ISO 11898-1, extended format).
EXTENDED: Final = 0x01
#: Remote frame.
REMOTE: Final = 0x02
#: Not a frame of the bus but the controller's report of an error; `data` as SocketCAN's error frames.
ERROR: Final = 0x04
#: CAN FD frame, with its bit-rate switch and error-state indicator.
FD: Final = 0x08
BRS: Final = 0x10
ESI: Final = 0x20
#: A frame this very connection sent, reported back when it had been transmitted.
ECHO: Final = 0x40

#: Bytes a CAN FD frame can carry, by DLC (ISO 11898-1:2015, table 5).
FD_LENGTHS: Final = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)

#: One frame: `time_ns` of the end of frame (of one to send: its earliest start), `expires_ns` when a waiting frame
#: is given up (0: never), `length` in bytes (not DLC), `port` the sending controller when one connection carries
#: several, `data` padded with zeros.
FRAME: Final = np.dtype(
    [
        ("time_ns", "<i8"),
        ("expires_ns", "<i8"),
        ("can_id", "<u4"),
        ("length", "u1"),
        ("flags", "u1"),
        ("port", "<u2"),
        ("data", "u1", (64,)),
    ]
)

Frames = npt.NDArray[np.void]


def frames(count: int) -> Frames:
    """Return `count` zeroed frames."""
    return np.zeros(count, FRAME)


def one_frame(can_id: int, data: bytes = b"", flags: int = 0) -> Frames:
    """Return a burst of one frame."""
    frame = frames(1)
    frame["can_id"], frame["length"], frame["flags"] = can_id, len(data), flags
    frame["data"][0, : len(data)] = tuple(data)
    return frame
