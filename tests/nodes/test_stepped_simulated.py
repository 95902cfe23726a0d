"""Stepped nodes on a simulated bus: what they send of a touch."""

import numpy as np
import pytest

from dbc.contract import Contract
from nodes.steps.simulated import touched_frames
from skin.sources import Frame
from skin.walsh import walsh_matrix
from tests.layouts import STEPPED, buses, small_layout
from tests.nodes.stepped_bus import SLOT_MS, Receiver

#: Four patches of 4 x 8 taxels on two buses.
CONTRACT = Contract.from_layout(small_layout(8, 16, **STEPPED, bus=buses(2, 2)))
BEGIN_STEP = 5


class OnePatch:
    """From 50 ms on a force on the patch of one block."""

    has_noise = False

    def __init__(self, contract: Contract, block: int) -> None:
        self.force_n = np.zeros(128, np.float32)
        self.taxels = CONTRACT.phi.taxels_of_blocks[block]
        self.force_n[self.taxels] = np.random.default_rng(1).uniform(0.004, 0.012, 32)

    def frame(self, step: int) -> Frame:
        force_n = self.force_n if step >= BEGIN_STEP else np.zeros(128, np.float32)
        return Frame(force_n.reshape(8, 16), "")


def test_the_touched_node_of_the_bus_sends_what_a_receiver_needs() -> None:
    touched = CONTRACT.on_bus(1)[0]
    source = OnePatch(CONTRACT, touched.block)
    sent = touched_frames(CONTRACT, 1, source, 0.6, seed=1)
    assert set(sent["can_id"].tolist()) == {0x181, 0x182}
    assert set(sent["length"].tolist()) == {8}
    assert (np.diff(sent["time_ns"]) > 0).all()
    assert sent["time_ns"][-1] < 601_000_000
    mine, other = (sent[sent["can_id"] == can_id] for can_id in (0x181, 0x182))
    assert len(other) == 11 + 2  # all groups, and checks
    # A step of the touch lasts 10 ms, and the force grows in the step before.
    first_ns = mine["time_ns"][11]
    assert 40_000_000 < mine["time_ns"][10] < first_ns < 65_000_000
    # In slots that begin with the SYNC for node 1, and half a slot later for node 2.
    for frames, begin_ms in ((mine, 0), (other, SLOT_MS / 2)):
        late_ns = (frames["time_ns"] - begin_ms * 1_000_000) % (SLOT_MS * 1_000_000)
        assert late_ns.max() < 1_300_000
    received = Receiver(CONTRACT)
    received.take(sent, 1)
    (part,) = (received.parts[each] for each in np.flatnonzero(CONTRACT.parts.block == touched.block))
    assert part.is_whole
    assert (part.gaps, part.different) == (1, 0)
    true_n = walsh_matrix(32) @ source.force_n[source.taxels]
    shown_n = part.known * CONTRACT.unit_n
    # A seventh of the noise is left of 1 mN in each sample of a taxel, root mean square.
    assert np.square(shown_n - true_n).mean() ** 0.5 < 4 * CONTRACT.unit_n + 32**0.5 * 0.15e-3
    assert np.abs(shown_n).max() > 0.1


def test_the_same_seed_sends_the_same_frames() -> None:
    source = OnePatch(CONTRACT, CONTRACT.on_bus(0)[1].block)
    one, same, other = (touched_frames(CONTRACT, 0, source, 0.1, seed=seed) for seed in (3, 3, 4))
    assert one.tobytes() == same.tobytes() != other.tobytes()
    assert np.max(one["time_ns"]) == pytest.approx(75e6, abs=27e6)
