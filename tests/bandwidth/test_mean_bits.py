"""Computed means against means of many random frames."""

import numpy as np
import pytest

from bandwidth.mean_bits import mean_wire_bits
from dbc.frame import BRS, ESI, EXTENDED, FD, Frames, frames
from dbc.frame_bits import wire_bits

SAMPLES = 20_000


@pytest.mark.heavy
@pytest.mark.parametrize("flags", [0, EXTENDED, FD, FD | BRS, FD | BRS | ESI, FD | EXTENDED])
@pytest.mark.parametrize("can_id", [None, 0x181])
@pytest.mark.parametrize("length", [2, 8, 64])
def test_mean_of_random_payloads(flags: int, can_id: int | None, length: int) -> None:
    if length > 8 and not flags & FD:
        length = 7
    random = np.random.default_rng(length + flags)
    many = frames(SAMPLES)
    many["flags"], many["length"] = flags, length
    many["data"][:, :length] = random.integers(0, 256, (SAMPLES, length))
    anything = random.integers(0, 1 << (29 if flags & EXTENDED else 11), SAMPLES)
    many["can_id"] = anything if can_id is None else can_id
    for computed, drawn in zip(mean_wire_bits(length, flags, can_id), wire_bits(many), strict=True):
        error = drawn.std() / np.sqrt(SAMPLES)
        assert computed == pytest.approx(drawn.mean(), abs=4 * error + 0.05)


@pytest.mark.parametrize(("length", "mean"), [(1, 56.9), (2, 65.1), (4, 81.2), (6, 97.7), (8, 114.2)])
def test_published_means(length: int, mean: float) -> None:
    assert mean_wire_bits(length)[0] == pytest.approx(mean, abs=0.3)


def every_payload(length: int, flags: int, can_id: int | None) -> Frames:
    """Return frames with each identifier of 11 bits, or the given one, and each payload."""
    ids = np.arange(2048) if can_id is None else np.array([can_id])
    count = 256**length
    every = frames(len(ids) * count)
    every["can_id"], every["length"], every["flags"] = np.repeat(ids, count), length, flags
    for place in range(length):
        every["data"][:, place] = np.tile(np.arange(count) >> 8 * place & 0xFF, len(ids))
    return every


@pytest.mark.parametrize(
    ("length", "flags", "can_id"),
    [
        (0, FD, None),
        (0, FD | BRS | ESI, None),
        (1, FD | BRS, 0x7FF),
        (1, FD | ESI, 0),
        (1, FD | BRS, 0x0F8),
        (2, FD | BRS, 0x181),
        (1, FD | BRS | EXTENDED, 0x1FFFFFFF),
        (1, FD | EXTENDED, 0x0003FFFF),
        (1, FD | BRS | ESI | EXTENDED, 0x1F83E0F8),
    ],
)
def test_the_mean_of_can_fd_is_that_of_every_payload(length: int, flags: int, can_id: int | None) -> None:
    """The CRC of CAN FD has fixed stuff bits, so nothing else is random."""
    nominal, data = (float(bits.mean()) for bits in wire_bits(every_payload(length, flags, can_id)))
    assert mean_wire_bits(length, flags, can_id) == pytest.approx((nominal, data), abs=1e-9)


@pytest.mark.parametrize(
    ("flags", "can_id", "head"),
    [
        (0, 0x000, "0" + "0" * 11 + "000" + "0000"),
        (0, 0x7FF, "0" + "1" * 11 + "000" + "0000"),
        (0, 0x181, "0" + "00110000001" + "000" + "0000"),
        (EXTENDED, 0x1FFFFFFF, "0" + "1" * 11 + "11" + "1" * 18 + "000" + "0000"),
        (EXTENDED, 0x0003FFFF, "0" + "0" * 11 + "11" + "1" * 18 + "000" + "0000"),
    ],
)
def test_the_mean_of_a_classic_frame_is_that_of_every_crc(flags: int, can_id: int, head: str) -> None:
    crc = np.arange(1 << 15)[:, None] >> np.arange(15) & 1
    bits = np.hstack([np.broadcast_to([int(bit) for bit in head], (len(crc), len(head))), crc])
    last, run, stuffed = np.full(len(crc), 2), np.zeros(len(crc), int), np.zeros(len(crc), int)
    for column in bits.T:
        run = np.where(column == last, run + 1, 1)
        is_full = run == 5
        stuffed += is_full
        last, run = np.where(is_full, 1 - column, column), np.where(is_full, 1, run)
    plain = 67 if flags & EXTENDED else 47
    assert mean_wire_bits(0, flags, can_id) == (pytest.approx(plain + stuffed.mean(), abs=1e-9), 0)


def test_lengths_without_a_dlc_are_those_of_the_next() -> None:
    assert mean_wire_bits(9, FD | BRS) == mean_wire_bits(12, FD | BRS)
    assert mean_wire_bits(49, FD) == mean_wire_bits(64, FD)
    assert mean_wire_bits(48, FD) != mean_wire_bits(64, FD)
