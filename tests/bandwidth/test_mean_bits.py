"""Computed means against means of many random frames."""

import numpy as np
import pytest

from bandwidth.mean_bits import mean_wire_bits
from dbc.frame import BRS, ESI, EXTENDED, FD, frames
from dbc.frame_bits import wire_bits

SAMPLES = 20_000


@pytest.mark.heavy
@pytest.mark.parametrize("flags", [0, EXTENDED, FD, FD | BRS, FD | BRS | ESI, FD | EXTENDED])
@pytest.mark.parametrize("can_id", [None, 0x181, 0x7F])
@pytest.mark.parametrize("length", [0, 2, 8, 12, 64])
def test_mean_of_random_payloads(flags: int, can_id: int | None, length: int) -> None:
    if length > 8 and not flags & FD:
        length = 7
    # Without data the CRC of one identifier is not random.
    slack = 3.0 if length == 0 and can_id is not None else 0.05
    random = np.random.default_rng(length + flags)
    many = frames(SAMPLES)
    many["flags"], many["length"] = flags, length
    many["data"][:, :length] = random.integers(0, 256, (SAMPLES, length))
    anything = random.integers(0, 1 << (29 if flags & EXTENDED else 11), SAMPLES)
    many["can_id"] = anything if can_id is None else can_id
    for computed, drawn in zip(mean_wire_bits(length, flags, can_id), wire_bits(many), strict=True):
        error = drawn.std() / np.sqrt(SAMPLES)
        assert computed == pytest.approx(drawn.mean(), abs=4 * error + slack)


@pytest.mark.parametrize(("length", "mean"), [(1, 56.9), (2, 65.1), (4, 81.2), (6, 97.7), (8, 114.2)])
def test_published_means(length: int, mean: float) -> None:
    assert mean_wire_bits(length)[0] == pytest.approx(mean, abs=0.3)


def test_padding_counts() -> None:
    assert mean_wire_bits(40, FD | BRS) == mean_wire_bits(48, FD | BRS)
