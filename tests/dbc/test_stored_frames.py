"""Frames as recordings store them."""

import numpy as np
import pytest

from dbc.frame import BRS, CLASSIC_BYTES, ERROR, EXTENDED, FD, FD_BYTES, frames
from dbc.stored_frames import from_bytes, record_type, to_bytes


@pytest.mark.parametrize("data_bytes", [CLASSIC_BYTES, FD_BYTES])
def test_frames_come_back(data_bytes: int) -> None:
    sent = frames(3)
    sent["time_ns"] = 1, 2**62, 3
    sent["can_id"] = 0x80, 0x1FFFFFFF, 4
    sent["flags"] = 0, EXTENDED | (FD | BRS if data_bytes == FD_BYTES else 0), ERROR
    sent["length"] = 0, data_bytes, 8
    sent["data"][1, :data_bytes] = np.arange(data_bytes) + 1
    stored = to_bytes(sent, data_bytes)
    assert len(stored) == 3 * (16 + data_bytes) == 3 * record_type(data_bytes).itemsize
    np.testing.assert_array_equal(from_bytes(stored, data_bytes), sent)


def test_half_a_record_is_refused() -> None:
    with pytest.raises(ValueError, match="multiple"):
        from_bytes(b"\0" * 25, CLASSIC_BYTES)
