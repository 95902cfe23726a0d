"""How the frames of a small log of adaptive nodes are sorted: by kind, level and node, with their load."""

import numpy as np
import pytest

from bandwidth.adaptive_log import AdaptiveLoad, measure_adaptive
from bandwidth.adaptive_plan import plan_adaptive
from bandwidth.measured import measure
from dbc.contract import Contract
from dbc.frame import Frames, one_frame
from dbc.frame_bits import wire_bits
from tests.layouts import ADAPTIVE, buses, small_layout

CONTRACT = Contract.from_layout(small_layout(**ADAPTIVE, bus=buses(2, names=["arm"])))
ONE, OTHER = b"\x55" * 8, b"\x33" * 8


def at(time_ms: int, can_id: int, data: bytes) -> Frames:
    frame = one_frame(can_id, data)
    frame["time_ns"] = time_ms * 1_000_000
    return frame


#: 0.2 seconds from the first SYNC to the last. 32 identifiers a TPDO: coarse frames of level 5 from 0x181 on, four
#: groups a level; fine frames of level 1 from 0x481 on, of level 0 from 0x501 on.
LOG = np.concatenate([
    at(1000, 0x80, b"\1"),
    at(1010, 0x181, ONE),
    at(1020, 0x181, ONE),
    at(1030, 0x181, OTHER),
    at(1040, 0x402, ONE),
    at(1050, 0x481, ONE),
    at(1060, 0x562, ONE),
    at(1100, 0x80, b"\2"),
    at(1105, 0x701, b"\5"),
    at(1200, 0x80, b"\3"),
])  # fmt: skip


def measured() -> AdaptiveLoad:
    (planned,) = plan_adaptive(CONTRACT, is_touched=False)
    return measure_adaptive(CONTRACT, 0, LOG, measure(CONTRACT, 0, LOG, planned))


def load_of(*places: int) -> float:
    """Return the load of frames of the log: their bits in 0.2 s at 1 Mbit/s."""
    return float(wire_bits(LOG)[0][list(places)].sum()) / 0.2e6


def test_frames_are_counted_by_kind_and_level_the_most_urgent_first() -> None:
    levels = measured().levels
    assert [(each.kind, each.level) for each in levels] == [
        *(("coarse", level) for level in (5, 4, 3, 2, 1, 0)),
        ("fine", 1),
        ("fine", 0),
    ]
    assert [each.frames for each in levels] == [3, 0, 0, 0, 0, 1, 1, 1]
    assert [each.rate_hz for each in levels] == pytest.approx([15, 0, 0, 0, 0, 5, 5, 5])
    loads = [load_of(1, 2, 3), 0, 0, 0, 0, load_of(4), load_of(5), load_of(6)]
    assert [each.load_exact for each in levels] == pytest.approx(loads)


def test_nodes_send_news_the_same_again_and_details_that_may_refine_nothing() -> None:
    """The first node's details are those of other coarse sums; the second's come before any coarse sums of the log."""
    one, two = measured().nodes
    assert (one.node_id, one.news, one.again, one.fine, one.unrefined, one.heartbeats) == (1, 2, 1, 1, 1, 1)
    assert (two.node_id, two.news, two.again, two.fine, two.unrefined, two.heartbeats) == (2, 1, 0, 1, 0, 0)
    assert one.load_exact == pytest.approx(load_of(1, 2, 3, 5, 8))
    assert two.load_exact == pytest.approx(load_of(4, 6))
