"""The collector: every frame once, none of another cycle, and counts that balance."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dbc.canopen import SYNC_COB_ID
from dbc.codec import encode
from dbc.contract import Contract, next_counter, phase_of
from dbc.frame import ECHO, ERROR, EXTENDED, FRAME, REMOTE, Frames, frames
from gateway.collector import Collector
from skin.layout import load_layout
from tests.bus.harness import frame

CONTRACT = Contract.from_layout(load_layout())
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
    rows = np.flatnonzero((TABLE.bus == bus) & (TABLE.phase == phase_of(counter)))
    out = frames(len(rows))
    out["can_id"], out["length"] = TABLE.cob_id[rows], TABLE.length[rows]
    out["data"][:, :8] = encode(sums, TABLE.gather[rows], CONTRACT.packing)
    return out


def received(collector: Collector) -> int:
    return collector.counts.received + collector.counts.foreign


def test_a_whole_cycle() -> None:
    collector = new_collector()
    collector.open(1)
    for bus in range(4):
        assert not collector.is_settled(1)
        collector.take(bus, np.concatenate((echo(1), burst(bus, 1))))
    assert collector.is_settled(1)
    gathered = collector.close(1)
    assert gathered.complete
    assert np.array_equal(gathered.sums, SUMS)
    assert (collector.counts.accepted, collector.counts.missing, collector.counts.late) == (256, 0, 0)


def test_frame_after_the_next_sync_never_counts() -> None:
    collector = new_collector()
    collector.open(1)
    first = burst(0, 1)
    collector.take(0, np.concatenate((echo(1), first[:60])))
    collector.open(2)
    collector.take(0, np.concatenate((echo(2), first[60:], burst(0, 2, SUMS - 1))))
    old, new = collector.close(1), collector.close(2)
    assert collector.counts.late == 4
    assert not old.valid[30:32].any()
    assert old.valid[:30].all()
    assert new.valid[:32].all()
    assert np.array_equal(new.sums[:256], SUMS[:256] - 1)


def test_frame_on_the_wire_before_the_next_sync_counts_however_late_it_is_read() -> None:
    collector = new_collector()
    collector.open(1)
    collector.open(2)
    everything = [echo(1), burst(0, 1), echo(2), burst(0, 2)]
    collector.take(0, np.concatenate(everything))
    assert collector.close(1).valid[:32].all()
    assert collector.close(2).valid[:32].all()
    assert collector.counts.late == 0


def test_node_that_missed_a_sync_is_invalid_and_its_answer_to_the_old_one_is_late() -> None:
    collector = new_collector()
    for counter in (1, 2):
        collector.open(counter)
        collector.take(0, echo(counter))
    node = burst(0, 1)[:1]
    collector.take(0, node)
    assert collector.counts.late == 1
    assert not collector.close(2).valid[:32].any()


def test_old_values_are_never_used_again() -> None:
    collector = new_collector()
    for counter in (1, 2, 3):
        collector.open(counter)
        for bus in range(4):
            sent = burst(bus, counter)
            collector.take(bus, np.concatenate((echo(counter), sent if counter == 1 else sent[:-2])))
        gathered = collector.close(counter)
    assert list(np.flatnonzero(~gathered.valid)) == [31, 63, 95, 127]
    for block in (31, 63, 95, 127):
        assert not gathered.sums[CONTRACT.phi.block_of_sum == block].any()


def test_second_copy_is_ignored_and_a_differing_one_spoils_the_block() -> None:
    collector = new_collector()
    collector.open(1)
    sent = burst(0, 1)
    other = sent[10:11].copy()
    other["data"][0, 0] ^= 1
    collector.take(0, np.concatenate((echo(1), sent, sent[:4], other)))
    gathered = collector.close(1)
    assert collector.counts.duplicate == 5
    assert collector.counts.accepted == 64
    assert list(np.flatnonzero(~gathered.valid[:32])) == [
        CONTRACT.phi.block_of_sum[TABLE.gather[TABLE.row_of[0, other["can_id"][0]], 0]]
    ]


def test_untrusted_block_is_never_valid() -> None:
    collector = new_collector()
    collector.trust(slice(3, 4), proven=False)
    collector.open(1)
    for bus in range(4):
        collector.take(bus, np.concatenate((echo(1), burst(bus, 1))))
    gathered = collector.close(1)
    assert list(np.flatnonzero(~gathered.valid)) == [3]
    assert not gathered.sums[CONTRACT.phi.block_of_sum == 3].any()


@pytest.mark.parametrize("flags", [EXTENDED, REMOTE, EXTENDED | REMOTE])
def test_frames_of_another_kind_are_foreign(flags: int) -> None:
    collector = new_collector()
    collector.open(1)
    sent = burst(0, 1)
    sent["flags"] = flags
    collector.take(0, np.concatenate((echo(1), sent)))
    assert collector.counts.foreign == 64
    assert not collector.close(1).valid.any()


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_any_frames_are_counted_and_never_raise(seed: int) -> None:
    random = np.random.default_rng(seed)
    collector = new_collector()
    counter, given_frames = 1, 0
    for _ in range(6):
        collector.open(counter)
        for bus in range(4):
            wild = np.frombuffer(random.bytes(50 * FRAME.itemsize), FRAME).copy()
            wild["can_id"] = random.integers(0, 0x900, 50)
            wild["flags"] &= np.uint8(random.choice([0, ERROR | ECHO, 0xFF]))
            mixed = np.concatenate((echo(counter), burst(bus, counter), wild, burst(bus, counter)[:9]))
            mixed[1:] = random.permutation(mixed[1:])
            given_frames += int((mixed["flags"] & (ERROR | ECHO) == 0).sum())
            collector.take(bus, mixed)
        collector.close(counter)
        counter = next_counter(counter)
    assert received(collector) == given_frames
    assert collector.counts.accepted + collector.counts.missing == 6 * 256


def test_syncs_that_waited_in_the_controller_spoil_their_bus() -> None:
    """Three leave back to back when the bus comes back: the answers to the first pass for those to the third."""
    collector = new_collector()
    for counter, end_ns in ((1, 10_000_000), (2, 30_000_000), (3, 30_200_000)):
        collector.open(counter)
        for bus in range(4):
            start = echo(counter)
            start["time_ns"] = end_ns if bus == 0 else counter * 10_000_000
            collector.take(bus, np.concatenate((start, burst(bus, counter))))
    assert not collector.close(2).valid[:32].any()
    late = collector.close(3)
    assert not late.valid[:32].any()
    assert late.valid[32:].all()
