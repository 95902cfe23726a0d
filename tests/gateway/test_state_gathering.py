"""Sums of nodes with two states: each SYNC begins a cycle of its state, and the counts are of both."""

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from canskin.messages import Measurement
from dbc.canopen import NmtState
from dbc.contract import Contract
from dbc.dictionary import SkinState
from dbc.frame import ECHO, Frames, frames
from gateway.gathering import Health, Sync
from gateway.nmt_master import NmtMaster
from gateway.state_gathering import StateGathering
from tests.bus.harness import frame
from tests.gateway.helpers import two_states

CONTRACT = two_states()

#: Images: two frames of each of four blocks. Recognition: a frame of each of three blocks, the fourth has no sum.
IMAGES, FEW = CONTRACT.states
START_NS = 100_000_000_000


def answers(contract: Contract, bus: int, counter: int) -> Frames:
    rows = np.flatnonzero(contract.table.bus == bus)
    burst = frames(len(rows))
    burst["can_id"], burst["length"] = contract.table.cob_id[rows], contract.table.length[rows]
    burst["data"][:, 0] = counter
    return burst


class Skin:
    """A gathering with all nodes proven, and SYNCs that end at once."""

    def __init__(self) -> None:
        self.gathering = StateGathering(CONTRACT)
        self.number = 0
        self.now_ns = START_NS
        for node in CONTRACT.nodes:
            self.gathering.trust(node, proven=True)

    def sync(self, state: SkinState) -> list[Measurement]:
        """Send a SYNC 60 ms after the one before."""
        self.number += 1
        self.now_ns += 60_000_000
        sync = Sync(self.number, self.number, self.now_ns, self.now_ns, 3, state=state)
        closed = self.gathering.begin(sync)
        for bus in (0, 1):
            self.take(bus, frame(0x80, bytes((self.number,)), ECHO, time_ns=self.now_ns + 1000))
        return closed

    def take(self, bus: int, burst: Frames) -> None:
        self.gathering.take(bus, burst, Health(), self.now_s)

    def answer(self, contract: Contract) -> None:
        for bus in (0, 1):
            self.take(bus, answers(contract, bus, self.number))

    def cycle(self, state: SkinState) -> list[Measurement]:
        """Go through a cycle in which every node answers."""
        self.sync(state)
        self.answer(IMAGES if state == SkinState.IMAGES else FEW)
        return self.gathering.measurements(self.now_s, 0)

    @property
    def now_s(self) -> float:
        return self.now_ns * 1e-9


@pytest.fixture
def skin() -> Skin:
    return Skin()


def test_a_cycle_has_the_sums_of_the_state_of_its_sync(skin: Skin) -> None:
    (few,) = skin.cycle(SkinState.RECOGNITION)
    assert (few.cycle, few.fingerprint, few.wall_offset_ns) == (1, FEW.phi.fingerprint, 3)
    assert few.valid == bytes((1, 1, 1, 0))
    assert (skin.gathering.published, skin.gathering.complete) == (1, 1)
    (first,) = skin.cycle(SkinState.IMAGES)
    assert (first.cycle, first.fingerprint, first.valid) == (2, IMAGES.phi.fingerprint, bytes((1, 1, 1, 1)))
    (image,) = skin.cycle(SkinState.IMAGES)
    assert image.valid == bytes((1, 1, 1, 1))
    assert (skin.gathering.published, skin.gathering.complete) == (3, 3)
    assert skin.gathering.in_flight == 0


def test_frames_of_the_other_state_are_late_and_not_foreign(skin: Skin) -> None:
    skin.cycle(SkinState.RECOGNITION)
    counts = skin.gathering.counts
    assert (counts.accepted, counts.foreign, counts.late, counts.missing) == (3, 0, 0, 0)
    skin.cycle(SkinState.IMAGES)
    skin.answer(FEW)
    skin.take(0, frame(0x555, b"\1"))
    counts = skin.gathering.counts
    assert (counts.accepted, counts.foreign, counts.late, counts.missing) == (11, 1, 3, 0)
    skin.sync(SkinState.IMAGES)
    skin.take(0, np.concatenate([answers(IMAGES, 0, skin.number)[:1]] * 2))
    malformed = answers(FEW, 1, skin.number)[:1]
    malformed["length"] -= 1
    skin.take(1, malformed)
    skin.gathering.measurements(skin.now_s + 1, 0)
    counts = skin.gathering.counts
    assert (counts.accepted, counts.duplicate, counts.malformed, counts.missing) == (12, 1, 1, 7)
    assert counts.foreign == 1


def test_open_cycles_of_both_states_are_counted_and_end_by_their_number(skin: Skin) -> None:
    assert skin.gathering.due_s == float("inf")
    skin.sync(SkinState.IMAGES)
    first_s = skin.now_s
    assert skin.gathering.in_flight == 1
    assert skin.gathering.due_s == pytest.approx(first_s + 1.9 * 0.05)
    skin.sync(SkinState.RECOGNITION)
    assert skin.gathering.in_flight == 2
    few_s = skin.now_s + 1.9 * 0.01
    assert skin.gathering.due_s == pytest.approx(min(first_s + 1.9 * 0.05, few_s))
    assert [each.cycle for each in skin.gathering.measurements(skin.now_s + 1, 0)] == [1, 2]
    skin.sync(SkinState.RECOGNITION)
    skin.sync(SkinState.IMAGES)
    made = skin.gathering.measurements(skin.now_s + 1, 0)
    assert [(each.cycle, each.fingerprint) for each in made] == [(3, FEW.phi.fingerprint), (4, IMAGES.phi.fingerprint)]
    assert skin.gathering.in_flight == 0


def test_a_sync_closes_the_cycle_before_the_last_whatever_its_state(skin: Skin) -> None:
    skin.sync(SkinState.IMAGES)
    assert skin.sync(SkinState.RECOGNITION) == []
    assert [each.cycle for each in skin.sync(SkinState.RECOGNITION)] == [1]
    assert [each.cycle for each in skin.sync(SkinState.IMAGES)] == [2]
    assert skin.gathering.in_flight == 2


def test_a_node_that_is_doubted_is_valid_in_neither_state(skin: Skin) -> None:
    skin.gathering.trust(CONTRACT.nodes[1], proven=False)
    (few,) = skin.cycle(SkinState.RECOGNITION)
    skin.cycle(SkinState.IMAGES)
    (image,) = skin.cycle(SkinState.IMAGES)
    assert (few.valid, image.valid) == (bytes((1, 0, 1, 0)), bytes((1, 0, 1, 1)))
    skin.gathering.trust(CONTRACT.nodes[1], proven=True)
    assert skin.cycle(SkinState.IMAGES)[0].valid == bytes((1, 1, 1, 1))


def test_cycles_of_both_states_wait_for_operational_nodes_alone(skin: Skin) -> None:
    masters = {
        number: cast("NmtMaster", SimpleNamespace(node_ids=[1, 2], nmt=np.array(states, np.uint8)))
        for number, states in enumerate([(NmtState.OPERATIONAL, NmtState.STOPPED), (NmtState.STOPPED,) * 2])
    }
    skin.gathering.look(masters)
    for state, contract in ((SkinState.IMAGES, IMAGES), (SkinState.RECOGNITION, FEW)):
        skin.sync(state)
        assert skin.gathering.measurements(skin.now_s, 0) == []
        skin.take(0, answers(contract, 0, skin.number)[contract.table.node[contract.table.bus == 0] == 0])
        assert len(skin.gathering.measurements(skin.now_s, 0)) == 1


def test_missing_and_late_frames_of_a_node_are_those_of_both_states(skin: Skin) -> None:
    for state in (SkinState.IMAGES, SkinState.RECOGNITION):
        skin.sync(state)
        skin.gathering.measurements(skin.now_s + 1, 0)
    assert [skin.gathering.missing_and_late(place) for place in range(4)] == [(3, 0), (3, 0), (3, 0), (2, 0)]
    skin.answer(IMAGES)
    skin.answer(FEW)
    assert [skin.gathering.missing_and_late(place) for place in range(4)] == [(3, 3), (3, 3), (3, 3), (2, 2)]


def test_a_foreign_sync_is_counted_once_though_two_states_see_it(skin: Skin) -> None:
    skin.take(1, np.concatenate([frame(0x80)] * 3))
    assert [skin.gathering.take_foreign_syncs(bus) for bus in (0, 1, 1)] == [0, 3, 0]


def test_foreign_syncs_are_forgotten_while_the_other_state_is_asked_for(skin: Skin) -> None:
    for counter in range(1, 241):
        skin.take(0, frame(0x80, bytes((counter,))))
    for _ in range(239):
        skin.cycle(SkinState.RECOGNITION)
    skin.number = 0
    # The fourth block has no sum in recognition: nothing told that its node holds back no image.
    assert [skin.cycle(SkinState.IMAGES)[0].valid[:3] for _ in range(3)] == [bytes((1, 1, 1))] * 3


def test_after_a_silence_in_both_states_two_cycles_prove_the_node(skin: Skin) -> None:
    for _ in range(130):
        skin.sync(SkinState.RECOGNITION)
        skin.gathering.measurements(skin.now_s + 1, 0)
    assert [skin.cycle(SkinState.IMAGES)[0].valid for _ in range(3)] == [bytes(4)] * 2 + [bytes((1, 1, 1, 1))]
