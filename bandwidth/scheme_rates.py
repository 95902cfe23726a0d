"""Rates of ways to send a skin's values that a layout cannot describe, for comparisons.

Values are packed without gaps, also across frames. A bus may have more nodes than node-IDs; `Scheme.fits_node_ids`
tells whether it has. `bandwidth.alternatives` has layouts.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from itertools import product
from typing import Final

import numpy as np

from bandwidth.alternatives import BLOCKS_PER_NODE, FD_BITRATES
from bandwidth.mean_bits import mean_wire_bits
from bandwidth.plan import CAUTION, BusTime, sync_bits
from dbc.canopen import HIGHEST_NODE_ID
from dbc.dictionary import HEARTBEAT_MS
from dbc.frame import BRS, CLASSIC_BYTES, FD, FD_BYTES, FD_LENGTHS, frames
from dbc.frame_bits import wire_bits
from skin.layout import SUM_BITS, Layout

TAXEL_BITS: Final = (10, 12, 16)
BUSES: Final = (1, 2, 4)
#: Data bit rates of CAN FD; None is classic CAN.
DATA_BITRATES: Final = (None, *FD_BITRATES)
#: Longest CAN FD frames to compare, bytes.
FD_LIMITS: Final = (8, 16, 32, FD_BYTES)
BITRATE: Final = 1_000_000


@dataclass(frozen=True)
class Scheme:
    """A way to send `values` of `bits` each from `nodes` over `buses`, and its SYNC rates.

    `payloads` are the bytes of one node's frames, `most_bytes` is the longest frame allowed. Rates are those of the bus
    with the most nodes: for random data, for the most stuff bits, and for the most stuff bits at a load of 80 %.
    """

    what: str
    values: int
    bits: int
    blocks_per_node: int
    nodes: int
    buses: int
    data_bitrate: int | None
    most_bytes: int
    payloads: list[int]
    frames_per_cycle: int
    fits_node_ids: bool
    max_rate_hz_random: float
    max_rate_hz_worst: float
    max_rate_hz_worst_80: float


def schemes(layout: Layout) -> Iterator[Scheme]:
    """Yield the sums and the full scan of a skin in every width, topology and type of CAN."""
    sums, taxels, blocks = layout.measurement.sums, layout.taxels.count, layout.blocks
    rows = [("sums", sums, bits, each) for bits in SUM_BITS for each in BLOCKS_PER_NODE]
    rows += [("taxels", taxels, bits, 1) for bits in TAXEL_BITS]
    for (what, values, bits, per_node), rate in product(rows, DATA_BITRATES):
        nodes = -(-blocks // per_node)
        size = -(-values * bits // (8 * nodes))
        for most, buses in product([CLASSIC_BYTES] if rate is None else _useful_limits(size), BUSES):
            payloads = _payloads(size, most)
            on_bus = -(-nodes // buses)
            average, worst = (_bus_time(payloads, on_bus, rate, is_worst=each) for each in (False, True))
            yield Scheme(
                what=what,
                values=values,
                bits=bits,
                blocks_per_node=per_node,
                nodes=nodes,
                buses=buses,
                data_bitrate=rate,
                most_bytes=most,
                payloads=payloads,
                frames_per_cycle=nodes * len(payloads),
                fits_node_ids=on_bus <= HIGHEST_NODE_ID,
                max_rate_hz_random=average.rate_hz(),
                max_rate_hz_worst=worst.rate_hz(),
                max_rate_hz_worst_80=worst.rate_hz(CAUTION),
            )


def _useful_limits(size: int) -> list[int]:
    """Return the limits of frame length that shorten a frame, and the limit of the standard."""
    return [most for most in FD_LIMITS if most < size or most == FD_BYTES]


def _payloads(size: int, most: int) -> list[int]:
    """Divide `size` bytes into full frames and a last frame, which CAN FD pads."""
    full, rest = divmod(size, most)
    padded = [next(each for each in FD_LENGTHS if each >= rest)] if rest else []
    return [most] * full + padded


def _bus_time(payloads: list[int], nodes: int, data_bitrate: int | None, *, is_worst: bool) -> BusTime:
    """Return the bus time of `nodes` nodes that send `payloads` each, with SYNC and heartbeats."""
    flags = FD | BRS if data_bitrate else 0
    sizes = [_frame_bits(length, flags, is_worst=is_worst) for length in payloads]
    nominal, data = (nodes * total for total in np.sum(sizes, axis=0).tolist())
    sync, beat = _short_bits(is_worst=is_worst)
    nominal += sync
    return BusTime(
        cycle_s=nominal / BITRATE + data / (data_bitrate or BITRATE),
        cycle_bits=nominal + data,
        beats_s=nodes * beat / (HEARTBEAT_MS * 1e-3) / BITRATE,
    )


@cache
def _frame_bits(length: int, flags: int, *, is_worst: bool) -> tuple[float, float]:
    if not is_worst:
        return mean_wire_bits(length, flags)
    one = frames(1)
    one["length"], one["flags"] = length, flags
    nominal, data = wire_bits(one, "worst")
    return float(nominal[0]), float(data[0])


@cache
def _short_bits(*, is_worst: bool) -> tuple[float, float]:
    """Return the bits of SYNC, with counter, and of a heartbeat, each a classic frame of one byte."""
    if is_worst:
        return (_frame_bits(1, 0, is_worst=True)[0],) * 2
    return sync_bits(1), mean_wire_bits(1)[0]
