"""When frames with one identifier collide."""

import numpy as np
import pytest

from bus.pending import clash_bits
from dbc.frame import FD, Frames
from tests.bus.harness import frame


@pytest.mark.parametrize(
    ("other", "bits"),
    [
        (frame(0x100, b"\x01\x02\x03"), None),
        (frame(0x100, b"\x01\x02\x04"), 19 + 2 * 8),
        (frame(0x100, b"\x00\x02\x03"), 19),
        (frame(0x100, b"\x01\x02\x03\x00"), 19),  # another DLC
        (frame(0x100, b"\x01\x02\x03", FD), 19),
    ],
)
def test_equal_identifiers_clash_where_the_frames_differ(other: Frames, bits: int | None) -> None:
    one = frame(0x100, b"\x01\x02\x03")
    assert clash_bits(np.concatenate([one, other])) == bits
    assert clash_bits(np.concatenate([one, one, other])) == bits
