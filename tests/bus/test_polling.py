"""Nodes that make their frames anew until they win the bus."""

import numpy as np

from bus.polling import poll
from bus.simulated_bus import SimulatedBus
from dbc.frame import Frames, frames

PERIOD_NS = 1_000_000


class Talkers:
    """Twelve nodes that offer the number of the period, in every period, until they were heard once."""

    def __init__(self) -> None:
        self.waiting = set(range(12))
        self.unsent = 0

    def take(self, ended: Frames, unsent: Frames) -> None:
        self.waiting -= {int(each) - 0x200 for each in ended["can_id"]}
        self.unsent += len(unsent)

    def offer(self, period: int) -> Frames:
        offered = frames(len(self.waiting))
        offered["can_id"], offered["length"] = 0x200 + np.array(sorted(self.waiting), np.uint32), 8
        offered["data"][:, 0] = period
        return offered


def test_what_has_not_won_comes_back_and_is_made_anew() -> None:
    """Of 8 bytes about eight frames fit into a period; one that began before its end arrives."""
    nodes, others = Talkers(), frames(1)
    others["can_id"], others["time_ns"] = 0x80, PERIOD_NS
    sent = poll(SimulatedBus(), nodes, others, 3, PERIOD_NS)
    assert (np.diff(sent["time_ns"]) > 0).all()
    talked = sent[sent["can_id"] != 0x80]
    assert sorted(set(talked["can_id"].tolist())) == list(range(0x200, 0x20C))
    made_ns, longest_ns = talked["data"][:, 0].astype(np.int64) * PERIOD_NS, 135_000
    assert (made_ns < talked["time_ns"]).all()
    assert (talked["time_ns"] < made_ns + PERIOD_NS + longest_ns).all()
    first = made_ns == 0
    assert 6 <= np.count_nonzero(first) <= 9
    assert nodes.unsent >= 12 - np.count_nonzero(first)
    assert not nodes.waiting


def test_the_frames_of_others_take_part() -> None:
    others = frames(2)
    others["can_id"], others["time_ns"] = (0x80, 0x700), (PERIOD_NS, 0)
    sent = poll(SimulatedBus(), Talkers(), others, 2, PERIOD_NS)["can_id"].tolist()
    # In the second period the lowest identifier wins as soon as the bus is free, the highest waits for all others.
    assert sent.index(0x80) < len(sent) - 2
    assert sent.index(0x700) > sent.index(0x80)
