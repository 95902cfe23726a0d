"""Cycles of the default skin with alternating identifiers, as a collector gets them."""

import numpy as np

from dbc.canopen import SYNC_COB_ID
from dbc.codec import encode
from dbc.contract import Contract
from dbc.frame import ECHO, Frames, frames
from gateway.collector import Collector, Gathered
from skin.layout import load_layout
from tests.bus.harness import frame
from tests.layouts import alternating

CONTRACT = Contract.from_layout(alternating(load_layout()))
TABLE = CONTRACT.table
RANDOM = np.random.default_rng(7)
SUMS = RANDOM.integers(-16368, 16369, 1024).astype(np.int16)


def new_collector() -> Collector:
    collector = Collector(CONTRACT)
    collector.trust(slice(None), proven=True)
    return collector


def echo(counter: int) -> Frames:
    return frame(SYNC_COB_ID, bytes((counter,)), ECHO)


def burst(bus: int, counter: int, sums: np.ndarray = SUMS) -> Frames:
    rows = np.flatnonzero((TABLE.bus == bus) & (TABLE.phase == CONTRACT.phase_of(counter)))
    out = frames(len(rows))
    out["can_id"], out["length"] = TABLE.cob_id[rows], TABLE.length[rows]
    out["data"][:, :8] = encode(sums, TABLE.gather[rows], CONTRACT.packing)
    return out


def whole_cycle(collector: Collector, counter: int) -> Gathered:
    collector.open(counter)
    for bus in range(4):
        collector.take(bus, np.concatenate((echo(counter), burst(bus, counter))), 0)
    return collector.close(counter)
