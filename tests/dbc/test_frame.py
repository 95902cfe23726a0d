"""Frames as records of 88 bytes."""

import numpy as np

from dbc import frame
from dbc.frame import EXTENDED, FD_LENGTHS, FRAME, frame_bytes, frames, one_frame


def test_one_frame_holds_what_it_is_given_and_zeros() -> None:
    made = one_frame(0x1ABCDEF0, b"\x01\x02\x03", EXTENDED)
    assert (made["can_id"][0], made["length"][0], made["flags"][0]) == (0x1ABCDEF0, 3, EXTENDED)
    assert made["data"][0].tobytes() == b"\x01\x02\x03" + bytes(61)
    assert (made["time_ns"][0], made["expires_ns"][0], made["port"][0]) == (0, 0, 0)
    assert one_frame(0x80).tobytes() == bytes(16) + b"\x80" + bytes(71)


def test_rows_of_bytes_are_a_view() -> None:
    burst = frames(3)
    rows = frame_bytes(burst)
    assert rows.shape == (3, FRAME.itemsize) == (3, 88)
    rows[1, 16] = 0x81
    assert burst["can_id"].tolist() == [0, 0x81, 0]
    assert frame_bytes(burst[::2]).shape == (2, 88)
    assert np.array_equal(frame_bytes(burst[1:]), rows[1:])


def test_flags_and_lengths_are_those_that_recordings_and_clients_know() -> None:
    """Payloads by DLC: ISO 11898-1:2015, table 5. Flags are bits of their own."""
    flags = {name: getattr(frame, name) for name in ("EXTENDED", "REMOTE", "ERROR", "FD", "BRS", "ESI", "ECHO")}
    assert flags == {"EXTENDED": 1, "REMOTE": 2, "ERROR": 4, "FD": 8, "BRS": 16, "ESI": 32, "ECHO": 64}
    assert (*range(9), 12, 16, 20, 24, 32, 48, 64) == FD_LENGTHS
    assert (frame.CLASSIC_BYTES, frame.FD_BYTES) == (8, 64)
