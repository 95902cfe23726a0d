"""Cycles of synchronous sums: for whom they wait, and when they end."""

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from dbc.canopen import NmtState
from dbc.contract import Contract
from gateway.cycle_gathering import CycleGathering
from gateway.gathering import Sync
from gateway.nmt_master import NmtMaster

DUE_S = 100.0


def sync(counter: int) -> Sync:
    """Return a SYNC at 20 Hz."""
    due_ns = 100_000_000_000 + 50_000_000 * (counter - 1)
    return Sync(number=counter + 6, counter=counter, due_ns=due_ns, sent_ns=due_ns, wall_offset_ns=17)


def master(*states: int) -> NmtMaster:
    return cast("NmtMaster", SimpleNamespace(node_ids=[1, 2], nmt=np.array(states, np.uint8)))


def test_a_cycle_waits_for_a_node_from_its_proof_on(small: Contract) -> None:
    gathering = CycleGathering(small)
    gathering.collector.expected[:] = False
    gathering.trust(small.nodes[0], proven=False)
    gathering.trust(small.nodes[2], proven=True)
    assert gathering.collector.expected.tolist() == [False, False, True, False]


def test_cycles_wait_for_nodes_that_are_operational_or_send(small: Contract) -> None:
    gathering = CycleGathering(small)
    gathering.collector.heard[:] = [True, False, True, False]
    masters = {0: master(NmtState.OPERATIONAL, NmtState.OPERATIONAL), 1: master(NmtState.STOPPED, NmtState.STOPPED)}
    gathering.look(masters, DUE_S)
    assert gathering.collector.expected.tolist() == [True, True, True, False]
    gathering.look(masters, DUE_S)
    assert gathering.collector.expected.tolist() == [True, True, False, False]


def test_a_cycle_ends_nine_tenths_of_a_period_after_the_next_sync(small: Contract) -> None:
    gathering = CycleGathering(small)
    assert (gathering.due_s, gathering.in_flight) == (float("inf"), 0)
    assert gathering.begin(sync(1)) == []
    assert gathering.begin(sync(2)) == []
    assert (gathering.due_s, gathering.in_flight) == (pytest.approx(100.095), 2)
    assert gathering.measurements(gathering.due_s - 1e-6, 0) == []
    (made,) = gathering.measurements(gathering.due_s, 0)
    assert (made.cycle, made.sync_counter, made.wall_offset_ns) == (7, 1, 17)
    assert (made.valid, gathering.published, gathering.complete) == (bytes(4), 1, 0)
    assert gathering.due_s == pytest.approx(100.145)


def test_a_third_cycle_ends_the_first(small: Contract) -> None:
    gathering = CycleGathering(small)
    for counter in (1, 2):
        gathering.begin(sync(counter))
    assert [each.sync_counter for each in gathering.begin(sync(3))] == [1]
    assert gathering.in_flight == 2
    assert [each.sync_counter for each in gathering.begin(sync(4), is_asked=False)] == [2]
    assert gathering.in_flight == 1


def test_missing_frames_are_told_by_node(small: Contract) -> None:
    gathering = CycleGathering(small)
    gathering.begin(sync(1))
    gathering.measurements(DUE_S + 1, 0)
    assert gathering.missing_and_late(0) == (len(small.nodes[0].tpdos), 0)
    gathering.collector.late_of_node[3] = 5
    assert gathering.missing_and_late(3) == (len(small.nodes[3].tpdos), 5)
