"""CAN frames as records of an array: a burst is one array, not hundreds of objects."""

from typing import Final

import numpy as np
import numpy.typing as npt

from skin.foreign import CLASSIC_MAX, FD_ONLY_LENGTHS

#: 29-bit identifier (ISO 11898-1, extended format).
EXTENDED: Final = 0x01
#: Remote frame.
REMOTE: Final = 0x02
#: A controller's report of an error, not a frame of the bus; `data` as in SocketCAN's error frames.
ERROR: Final = 0x04
#: CAN FD frame, with its bit-rate switch and error-state indicator.
FD: Final = 0x08
BRS: Final = 0x10
ESI: Final = 0x20
#: A frame that this connection sent, reported back after its transmission.
ECHO: Final = 0x40

#: Longest payload of a classic CAN and of a CAN FD frame.
CLASSIC_BYTES: Final = CLASSIC_MAX
FD_BYTES: Final = FD_ONLY_LENGTHS[-1]
#: Payload bytes of a CAN FD frame, by DLC (ISO 11898-1:2015, table 5).
FD_LENGTHS: Final = (*range(CLASSIC_MAX + 1), *FD_ONLY_LENGTHS)

#: Bits of a classic frame without data: from its start to the CRC, with identifiers of 11 and 29 bits; and from the CRC
#: delimiter to the end of the intermission.
BASE_BITS, EXTENDED_BITS = 34, 54
CLASSIC_TAIL: Final = 13

#: One frame: `time_ns` end of frame (of a frame to send: earliest start), `expires_ns` latest start of a frame to send
#: (0: no limit), `length` in bytes (not DLC), `port` number of the sending controller on this connection, `data` padded
#: with zeros.
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

#: Where the fields of a FRAME begin, for compiled code.
TIME_AT, EXPIRES_AT, CAN_ID_AT, LENGTH_AT, FLAGS_AT, PORT_AT, DATA_AT = (
    FRAME.fields[name][1]  # type: ignore[index]  # FRAME has fields
    for name in ("time_ns", "expires_ns", "can_id", "length", "flags", "port", "data")
)

Frames = npt.NDArray[np.void]


def frames(count: int) -> Frames:
    """Return `count` zeroed frames."""
    return np.zeros(count, FRAME)


def received(arrived: Frames) -> Frames:
    """Return the data frames with identifiers of 11 bits that other stations have sent."""
    plain: Frames = arrived[arrived["flags"] & (ERROR | REMOTE | EXTENDED | ECHO) == 0]
    return plain


def frame_bytes(burst: Frames) -> npt.NDArray[np.uint8]:
    """Return frames as rows of bytes, shape (n, bytes of FRAME), for compiled code; a view where possible."""
    # Not `view`: NumPy compares the fields of both types each time, which takes three times as long.
    return np.ndarray((len(burst), FRAME.itemsize), np.uint8, np.ascontiguousarray(burst))


def one_frame(can_id: int, data: bytes = b"", flags: int = 0) -> Frames:
    """Return a burst of one frame."""
    frame = frames(1)
    frame["can_id"], frame["length"], frame["flags"] = can_id, len(data), flags
    frame["data"][0, : len(data)] = tuple(data)
    return frame
