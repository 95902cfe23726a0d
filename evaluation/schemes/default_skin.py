"""The default skin: what it takes of its buses, and others like it."""

from functools import cache

import msgspec

from bandwidth.alternatives import with_buses, with_rate
from dbc.contract import Contract
from evaluation.schemes.scenes import Touch
from evaluation.schemes.sums import run_sums
from skin.layout import load_layout


@cache
def default_kbit_per_s() -> float:
    """Return the kbit/s of the default skin at its own rate, all buses together, under the paper's golf ball."""
    layout = load_layout()
    contract = skin_of(layout.encoding.sum_bits, layout.sync.rate_hz)
    golf = Touch("golf-ball")
    return float(run_sums(contract, golf.load().counts, idle_counts=golf.idle()).sent.traffic()["kbit_per_s"])


@cache
def skin_of(bits: int, rate_hz: float) -> Contract:
    """Return the default skin, for 12 bits with two blocks per node, whose sums fill their frames."""
    layout = load_layout()
    if bits != layout.encoding.sum_bits:
        like = msgspec.structs.replace(layout.bus[0], blocks_per_node=2 if bits == 12 else 1)
        encoding = msgspec.structs.replace(layout.encoding, sum_bits=bits, offset_binary=True)
        layout = msgspec.structs.replace(with_buses(layout, len(layout.bus), like), encoding=encoding)
    return Contract.from_layout(with_rate(layout, rate_hz))
