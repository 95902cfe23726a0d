"""The collector: every frame once, none of another cycle, and counts that balance."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dbc.canopen import SYNC_COB_ID
from dbc.codec import encode
from dbc.contract import Contract
from dbc.frame import ECHO, ERROR, EXTENDED, FD, FRAME, REMOTE, Frames, frames
from gateway.collector import Collector, Gathered
from skin.sync_counter import next_counter
from tests.bus.harness import frame
from tests.layouts import in_one_instant

CONTRACT = Contract.from_layout(in_one_instant())
TABLE = CONTRACT.table
RANDOM = np.random.default_rng(7)
SUMS = 4 * RANDOM.integers(-4092, 4093, 1024).astype(np.int16)


def new_collector() -> Collector:
    collector = Collector(CONTRACT)
    collector.trust(slice(None), proven=True)
    return collector


def echo(counter: int) -> Frames:
    return frame(SYNC_COB_ID, bytes((counter,)), ECHO)


def burst(bus: int, counter: int, sums: np.ndarray = SUMS) -> Frames:
    rows = np.flatnonzero(TABLE.bus == bus)
    out = frames(len(rows))
    out["can_id"], out["length"] = TABLE.cob_id[rows], TABLE.length[rows]
    out["data"][:, :8] = encode(counter, sums, TABLE.gather[rows], CONTRACT.packing)
    return out


def whole_cycle(collector: Collector, counter: int) -> Gathered:
    collector.open(counter)
    for bus in range(4):
        collector.take(bus, np.concatenate((echo(counter), burst(bus, counter))), 0)
    return collector.close(counter)


def received(collector: Collector) -> int:
    return collector.counts.received + collector.counts.foreign


def test_proof_counts_from_the_next_sync_on_and_a_doubt_from_the_cycle_under_way() -> None:
    collector = new_collector()
    collector.trust(slice(3, 5), proven=False)
    collector.open(1)
    collector.trust(slice(3, 4), proven=True)
    collector.trust(slice(7, 8), proven=False)
    for bus in range(4):
        collector.take(bus, np.concatenate((echo(1), burst(bus, 1))), 0)
    assert np.flatnonzero(~collector.close(1).valid).tolist() == [3, 4, 7]
    assert np.flatnonzero(~whole_cycle(collector, 2).valid).tolist() == [4, 7]


@settings(max_examples=20, deadline=None)
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
            collector.take(bus, mixed, 0)
        collector.close(counter)
        counter = next_counter(counter)
    assert received(collector) == given_frames
    assert collector.counts.accepted + collector.counts.missing == 6 * 256


def changed(sent: Frames, **values: int) -> Frames:
    """Return the first frame of a burst with other `flags` or `length`."""
    frame_0 = sent[:1].copy()
    for key, value in values.items():
        frame_0[key] = value
    return frame_0


def with_other_data(sent: Frames) -> Frames:
    copy = sent[:1].copy()
    copy["data"][0, 1] ^= 1
    return copy


#: What may happen to the first frame of bus 0, in the order of the wire.
LOSSES = {
    "lost": lambda sent: [echo(1), sent[1:]],
    "of another cycle": lambda sent: [echo(1), burst(0, 2)[:1], sent[1:]],
    "without counter": lambda sent: [echo(1), burst(0, 0)[:1], sent[1:]],
    "shorter": lambda sent: [echo(1), changed(sent, length=7), sent[1:]],
    "longer": lambda sent: [echo(1), changed(sent, length=12), sent[1:]],
    "extended": lambda sent: [echo(1), changed(sent, flags=EXTENDED), sent[1:]],
    "remote": lambda sent: [echo(1), changed(sent, flags=REMOTE), sent[1:]],
    "of CAN FD": lambda sent: [echo(1), changed(sent, flags=FD), sent[1:]],
    "given back unsent": lambda sent: [echo(1), changed(sent, flags=ECHO | ERROR), sent[1:]],
    "its copy differs": lambda sent: [echo(1), sent, with_other_data(sent)],
}


@pytest.mark.parametrize("loss", LOSSES)
def test_whatever_befalls_a_frame_its_block_alone_is_invalid_and_the_next_cycle_is_whole(loss: str) -> None:
    collector = new_collector()
    collector.open(1)
    for bus in range(1, 4):
        collector.take(bus, np.concatenate((echo(1), burst(bus, 1))), 0)
    collector.take(0, np.concatenate(LOSSES[loss](burst(0, 1))), 0)
    gathered = collector.close(1)
    assert np.flatnonzero(~gathered.valid).tolist() == [0]
    assert not gathered.sums[CONTRACT.phi.block_of_sum == 0].any()
    assert whole_cycle(collector, 2).complete
    assert whole_cycle(collector, 3).complete


def test_frames_without_any_sync_are_late() -> None:
    collector = new_collector()
    collector.take(0, burst(0, 1), 0)
    assert (collector.counts.late, collector.counts.accepted) == (64, 0)


def test_cycle_waits_for_expected_nodes_only() -> None:
    collector = new_collector()
    collector.expected[0] = False
    of_node_1 = TABLE.node[TABLE.row_of[0, burst(0, 1)["can_id"]]] == 0
    collector.open(1)
    for bus in range(1, 4):
        collector.take(bus, np.concatenate((echo(1), burst(bus, 1))), 0)
    sent = burst(0, 1)
    others = sent[~of_node_1]
    collector.take(0, np.concatenate((echo(1), sent[of_node_1], others[2:])), 0)
    assert not collector.is_settled(1)  # the frames of node 1 count for nobody else
    collector.take(0, others[:2], 0)
    assert collector.is_settled(1)
    assert collector.close(1).complete
    collector.open(2)
    for bus in range(4):
        sent = burst(bus, 2)
        collector.take(bus, np.concatenate((echo(2), sent[~of_node_1] if bus == 0 else sent)), 0)
    assert collector.is_settled(2)


# SYNCs of others, SYNCs that ask for nothing, and what is known of the instant of a SYNC


def test_foreign_syncs_are_counted_from_the_last_question_on() -> None:
    collector = new_collector()
    assert [collector.take_foreign_syncs(bus) for bus in range(4)] == [0, 0, 0, 0]
    collector.take(2, np.concatenate([frame(SYNC_COB_ID, b"\1")] * 3), 0)
    assert [collector.take_foreign_syncs(bus) for bus in (1, 2, 2)] == [0, 3, 0]


def error_ns(stamp_error_ns: int | None) -> int:
    """Return the bound of an echo 0.7 ms after the SYNC was sent, with answers 0.9 ms and 1 ms after that."""
    collector = new_collector()
    collector.open(1, 10_000_000, 10_000_000)
    start, sent = echo(1), burst(0, 1)[:2]
    start["time_ns"] = 10_700_000
    sent["time_ns"] = 10_900_000, 11_000_000
    collector.take(0, np.concatenate((start, sent)), stamp_error_ns)
    return collector.close(1).times.error_ns


def test_the_first_answer_bounds_the_instant_where_there_are_no_time_stamps() -> None:
    assert 0 < error_ns(1_000) < 701_000
    assert error_ns(None) - error_ns(1_000) == 900_000 - (700_000 + 1_000)
