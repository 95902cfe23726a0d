"""Adaptive nodes on a simulated bus: what they send of a touch."""

import numpy as np
import pytest

from dbc.adaptive import frame_of
from dbc.contract import Contract
from gateway.adaptive_state import new_sums
from nodes.adaptive.simulated import touched_frames
from skin.sources import Frame
from skin.walsh import walsh_matrix
from tests.layouts import ADAPTIVE, GROUPS, buses, small_layout
from tests.nodes.adaptive_bus import receive

#: Four patches of 4 x 8 taxels on two buses.
CONTRACT = Contract.from_layout(small_layout(8, 16, **ADAPTIVE, bus=buses(2, 2)))
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
    assert {frame_of(int(each["can_id"]), groups=GROUPS)[0] for each in sent} == {touched.node_id - 1}
    assert (np.diff(sent["time_ns"]) > 0).all()
    assert (sent["time_ns"] % 100_000_000 > 2_000_000).all()  # none begins in the pause after a SYNC
    # A step of the touch lasts 10 ms, and the force grows in the step before.
    assert 40_000_000 < sent["time_ns"][0] < 55_000_000
    assert sent["time_ns"][-1] < 600_000_000
    assert set(sent["length"].tolist()) == {8}
    received = new_sums(2, GROUPS)
    receive(sent, CONTRACT.law, received)
    assert received.counts.tolist() == [len(sent), 0, 0, 0, 0, 0]
    true_n = walsh_matrix(32) @ source.force_n[source.taxels]
    place = touched.node_id - 1
    # A seventh of the noise is left of 1 mN in each sample of a taxel, root mean square.
    assert np.square(received.value_n[place] - true_n).mean() ** 0.5 < 2 * CONTRACT.law.fine_n + 32**0.5 * 0.15e-3
    assert np.abs(received.value_n[place]).max() > 0.1
    assert not len(touched_frames(CONTRACT, 0, source, 0.6, seed=1))


def test_the_same_seed_sends_the_same_frames() -> None:
    source = OnePatch(CONTRACT, CONTRACT.on_bus(0)[1].block)
    one, same, other = (touched_frames(CONTRACT, 0, source, 0.1, seed=seed) for seed in (3, 3, 4))
    assert one.tobytes() == same.tobytes() != other.tobytes()
    assert np.max(one["time_ns"]) == pytest.approx(75e6, abs=25e6)
