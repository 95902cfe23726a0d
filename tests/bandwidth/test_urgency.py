"""The bounds of adaptive nodes against random overloads of the arbitrated bus, which runs the nodes' own decisions."""

import os
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import msgspec
import numpy as np
import numpy.typing as npt
import pytest

from bandwidth.response import UNBOUNDED
from bandwidth.traffic import Disturbance
from bandwidth.urgency import Budgeted, Urgency
from dbc.adaptive import FIRST_COB_ID, GROUP_SUMS, LEVELS, SendingRule, coarse_value, decode_cob_id
from dbc.canopen import HEARTBEAT_BASE
from dbc.contract import Contract
from dbc.dictionary import HEARTBEAT_MS
from dbc.frame import BRS, FD, frames
from dbc.frame_bits import frame_time_ns
from nodes.adaptive.sending import Groups
from nodes.adaptive.simulated import SYNC_SAMPLES
from skin.layout import load_layout
from tests.bandwidth.adaptive_bus import run_bus
from tests.layouts import BLOCK_SUMS, GROUPS

MS = 1_000_000
NODES, TICKS = 32, 330
RULE = SendingRule()
#: Random overloads; docs/bandwidth.md names ten thousand.
OVERLOADS = int(os.environ.get("SKIN_OVERLOADS", "100"))
QUIET = Disturbance(0.0, 0.0, 0.0)
#: Bytes whose runs of four equal bits need the most stuff bits, and bytes near 0.
STUFFED = (0x0F, 0x1E, 0x3C, 0x78, 0xF0, 0xE1, 0xC3, 0x87)


@cache
def adaptive(*, fd: bool = False) -> Contract:
    """Return buses of 32 nodes; with `fd` slow ones, which 32 nodes can fill."""
    layout = load_layout(Path("adaptive"))
    if fd:
        rates = {"bitrate": 500_000, "data_bitrate": 600_000}
        lines = [msgspec.structs.replace(line, fd=True, **rates) for line in layout.bus]
        layout = msgspec.structs.replace(layout, bus=lines)
    return Contract.from_layout(layout)


def bounds(allowed: Disturbance = QUIET, contract: Contract | None = None) -> Urgency:
    return Urgency.of(contract or adaptive(), 0, allowed)


@dataclass
class Log:
    """The frames of a bus: of sums, shape (n,), and of heartbeats with the times they were due, shape (beats,).

    `since` is the sample that was first news, -1 for frames without news; `groups` is what the nodes know at the end.
    """

    node: npt.NDArray[np.int64]
    group: npt.NDArray[np.int64]
    is_fine: npt.NDArray[np.bool_]
    since: npt.NDArray[np.int64]
    ended_ns: npt.NDArray[np.int64]
    beat_node: npt.NDArray[np.int64]
    beat_due_ns: npt.NDArray[np.int64]
    beat_ended_ns: npt.NDArray[np.int64]
    groups: Groups

    def of(self, node: int, group: int) -> npt.NDArray[np.bool_]:
        """Tell which frames of sums are a group's."""
        return (self.node == node) & (self.group == group)


def arbitrated(
    sums_n: npt.NDArray[np.float32],
    threshold_n2: npt.NDArray[np.float64],
    beats: npt.NDArray[np.int64],
    contract: Contract | None = None,
) -> Log:
    """Run one bus; `beats` are the times of the first heartbeats."""
    line = (contract or adaptive()).layout.bus[0]
    sent, nodes = run_bus(line, adaptive().law, sums_n, threshold_n2, beats)
    can_id = sent["can_id"].astype(np.int64)
    is_sums = (can_id >= FIRST_COB_ID) & (can_id < HEARTBEAT_BASE)
    kind, group, node = (
        np.array([decode_cob_id(int(each), GROUPS, line.fd) for each in can_id[is_sums]]).reshape(-1, 3).T
    )
    beat = sent[can_id > HEARTBEAT_BASE]
    of_beat = beat["can_id"].astype(np.int64) - HEARTBEAT_BASE - 1
    turn = np.array([np.count_nonzero(of_beat[:place] == each) for place, each in enumerate(of_beat)], np.int64)
    due_ns = beats[of_beat] + HEARTBEAT_MS * MS * turn
    ended_ns = sent["time_ns"][is_sums]
    return Log(node, group, kind >= LEVELS, nodes.since, ended_ns, of_beat, due_ns, beat["time_ns"], nodes.groups)


@dataclass
class Overload:
    """Random sums of a bus: who moves, how much, how often and from when on."""

    seed: int

    def sums(self) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float64]]:
        """Return the sums of each millisecond, and the thresholds of news."""
        rng = np.random.default_rng(self.seed)
        law = adaptive().law
        pattern = rng.choice([*STUFFED, *range(1, 256)] if self.seed % 2 else STUFFED, (TICKS, NODES, GROUPS, 1))
        scale = np.ones((NODES, GROUPS, 1))
        if self.seed % 3 == 0:
            scale = 10 ** rng.uniform(-2.5, 0, scale.shape)
        kept = rng.choice([1, 1, 2, 5, 20], (NODES, GROUPS)) if self.seed % 5 else np.ones((NODES, GROUPS), np.int64)
        time = np.arange(TICKS)[:, None, None] // kept * kept
        pattern = np.take_along_axis(pattern, time[..., None], axis=0)
        table = np.array([coarse_value(code, False, law) for code in range(256)])
        moving = rng.random((NODES, GROUPS)) < rng.choice([0.3, 0.7, 1.0])
        # From a moment that makes the highest level begin with a SYNC or anywhere.
        begin = SYNC_SAMPLES - RULE.patience if self.seed % 4 == 0 else int(rng.integers(1, SYNC_SAMPLES))
        late = rng.integers(0, 30, (NODES, GROUPS)) if self.seed % 7 == 0 else np.zeros((NODES, GROUPS), np.int64)
        begun = (np.arange(TICKS)[:, None, None] >= begin + late) & moving
        groups_n = table[pattern] * scale * begun[..., None]
        sums_n = np.repeat(groups_n, GROUP_SUMS, axis=3).reshape(TICKS, NODES, BLOCK_SUMS)
        sums_n[:, :, 0] = np.abs(sums_n[:, :, 0])
        # Loud nodes have news far above their threshold, the others news that hardly counts.
        loud = np.arange(NODES) < rng.integers(2, NODES)
        rng.shuffle(loud)
        threshold = np.where(loud, 1e-6, GROUP_SUMS * 10 ** rng.uniform(-6, -4.5))
        return sums_n.astype(np.float32), np.broadcast_to(threshold, (TICKS, NODES)).copy()

    def run(self, contract: Contract) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
        """Return how long news waited, shape (NODES, GROUPS), and heartbeats, shape (NODES,), at worst."""
        sums_n, threshold_n2 = self.sums()
        rng = np.random.default_rng(self.seed)
        beats = np.full(NODES, int(rng.integers(0, 120 * MS)), np.int64)
        if self.seed % 2:
            beats = rng.integers(0, HEARTBEAT_MS * MS, NODES)
        log = arbitrated(sums_n, threshold_n2, beats, contract)
        waited = np.where(log.groups.since >= 0, (TICKS - log.groups.since) * MS, 0)
        news = log.since >= 0
        np.maximum.at(waited, (log.node[news], log.group[news]), log.ended_ns[news] - log.since[news] * MS)
        heard = np.bincount(log.beat_node, minlength=NODES)
        due_ns = beats + HEARTBEAT_MS * MS * heard
        beaten = np.where(due_ns < TICKS * MS, TICKS * MS - due_ns, 0)
        np.maximum.at(beaten, log.beat_node, log.beat_ended_ns - log.beat_due_ns)
        return waited, beaten


def compare(seeds: range, contract: Contract | None = None) -> tuple[float, float]:
    """Return how near news and heartbeats come to their bounds, which they must not exceed."""
    limit = bounds(contract=contract)
    beats_ns = limit.service_ns[limit.streams.is_heartbeat]
    nearest = 0.0, 0.0
    for seed in seeds:
        waited, beaten = Overload(seed).run(contract or adaptive())
        assert (waited <= limit.news_ns).all(), seed
        assert (beaten <= beats_ns).all(), seed
        nearest = max(nearest[0], (waited / limit.news_ns).max()), max(nearest[1], (beaten / beats_ns).max())
    return nearest


@pytest.mark.heavy
def test_random_overloads_stay_below_the_bounds_and_reach_them() -> None:
    news, beat = compare(range(OVERLOADS))
    assert news > 0.9
    assert beat > 0.9


@pytest.mark.heavy
def test_random_overloads_of_can_fd_stay_below_the_bounds() -> None:
    news, beat = compare(range(60), adaptive(fd=True))
    assert news > 0.7
    assert beat > 0.7


def test_a_group_at_rest_is_refreshed_while_all_others_move() -> None:
    """Its first refreshes are due after 64, 128, 256 ms; none waits longer than its bound, fine turns included."""
    rng, ticks, quiet = np.random.default_rng(5), 1400, (NODES - 1, GROUPS - 1)
    sums_n = rng.uniform(0.02, 0.3, (ticks, NODES, BLOCK_SUMS)).astype(np.float32)
    sums_n[:, NODES - 1] = 0
    sums_n[5:, NODES - 1, GROUP_SUMS * (GROUPS - 1) :] = 0.05
    log = arbitrated(sums_n, np.full((ticks, NODES), 1e-6), np.full(NODES, ticks * MS))
    ended_ns = log.ended_ns[log.of(*quiet)]
    assert len(ended_ns) == 3
    due_ns = ended_ns[:-1] + RULE.refresh * MS * 2 ** np.arange(len(ended_ns) - 1)
    assert (ended_ns[1:] - due_ns <= bounds().refresh_ns[quiet] + MS).all()
    assert (ended_ns[1:] - due_ns >= 0.9 * bounds().refresh_ns[quiet]).any()


@pytest.mark.parametrize("seed", range(10))
def test_what_came_to_rest_is_shown_coarse_and_fine_in_time(seed: int) -> None:
    rng, rest = np.random.default_rng(seed), 60 + 7 * seed
    sums_n = rng.uniform(0.005, 0.08, (TICKS, NODES, BLOCK_SUMS)).astype(np.float32)
    sums_n[rest:] = sums_n[rest]
    log = arbitrated(sums_n, np.full((TICKS, NODES), 1e-7), np.full(NODES, TICKS * MS))
    coarse_ns, fine_ns = bounds().settled_ns
    assert coarse_ns < fine_ns < UNBOUNDED
    news = log.since >= 0
    assert 0.4 * coarse_ns < log.ended_ns[news].max() - rest * MS <= coarse_ns
    for node in range(NODES):
        for group in range(GROUPS):
            mine = log.of(node, group)
            shown_ns = log.ended_ns[mine & news].max()
            # The first details after the last news; a later coarse refresh may need details again.
            refined_ns = log.ended_ns[mine & log.is_fine & (log.ended_ns > shown_ns)]
            assert (refined_ns[0] if len(refined_ns) else shown_ns) - rest * MS <= fine_ns
    assert (log.groups.since < 0).all()


def test_heartbeats_and_answers_share_the_pauses() -> None:
    limit = bounds(Disturbance(0.0, 20.0, 0.0))
    alone = bounds()
    beats = limit.service_ns[limit.streams.is_heartbeat]
    assert (np.diff(beats) >= 0).all()
    assert (beats > alone.service_ns[alone.streams.is_heartbeat]).all()
    # The gateway takes a node for silent when two heartbeats are 1.5 periods apart.
    assert beats.max() < HEARTBEAT_MS / 2 * MS
    assert (limit.service_ns[limit.streams.is_sdo_response] < 100 * MS).all()


def test_errors_lengthen_every_time() -> None:
    calm, rough = bounds(), bounds(Disturbance(0.0, 0.0, 100.0))
    assert (rough.news_ns > calm.news_ns).all()
    assert (rough.service_ns >= calm.service_ns).all()
    assert (bounds(Disturbance(0.0, 0.0, 20_000.0)).news_ns == UNBOUNDED).all()


def test_a_slow_bus_has_no_bound_but_for_the_first_groups() -> None:
    layout = adaptive().layout
    slow = msgspec.structs.replace(layout, bus=[msgspec.structs.replace(each, bitrate=250_000) for each in layout.bus])
    news_ns = bounds(contract=Contract.from_layout(slow)).news_ns
    assert news_ns[0, 0] < UNBOUNDED == news_ns[NODES - 1, GROUPS - 1]


def test_a_budget_bounds_the_load_and_lengthens_coarse_waits() -> None:
    limit = bounds()
    small, fair = Budgeted(limit, 5_000), Budgeted(limit, 24_000)
    assert small.coarse_ns == UNBOUNDED  # four groups every 24 ms take 22.5 kbit/s
    assert int(limit.news_ns.max()) < fair.coarse_ns < UNBOUNDED
    assert small.full_ns < fair.full_ns < UNBOUNDED == Budgeted(limit, 40_000).full_ns
    assert small.fine_ns < UNBOUNDED == Budgeted(limit, 40_000).fine_ns


def of_nodes(nodes: int, allowed: Disturbance = QUIET, *, fd: bool = False) -> Urgency:
    """Return the times of a bus with the services of 32 nodes and the sums of some."""
    return replace(bounds(allowed, adaptive(fd=fd)), nodes=nodes)


#: Half a millisecond of jitter, 20 SDO transfers and ten errors a second.
ROUGH = Disturbance(0.0005, 20.0, 10.0)


def test_frames_and_pauses_take_the_times_of_a_bus_of_1_mbit_s() -> None:
    """8 bytes: 44 + 64 + 24 stuff bits + 3; SYNC with a byte: 44 + 8 + 10 + 3; an error: 31 bits, the frame again."""
    limit = bounds(ROUGH)
    assert (limit.frame_ns, limit.coarse_frame_ns, limit.sync_ns) == (135_000, 135_000, 65_000)
    assert (limit.period_ns, limit.jitter_ns) == (100_000_000, 500_000)
    assert limit.above == [(65_000 + 2_000_000 + 135_000, 100_000_000, 500_000), (166_000, 100_000_000, 135_000)]
    assert bounds().above == [(2_200_000, 100_000_000, 0)]
    assert bounds(Disturbance()).jitter_ns == 100_000  # firmware of one's own answers at once


def test_a_node_alone_waits_for_a_pause_a_frame_and_its_own_frames() -> None:
    """2,200 µs of pause, 135 µs of a frame on its way, 135 µs for each of its frames; news waits 24 ms before that.

    At rest, a sample later: four coarse frames; then, 4 ms later, four refreshes and four fine frames.
    """
    alone = of_nodes(1)
    assert alone.top_ns.tolist() == [[2_470_000, 2_605_000, 2_740_000, 2_875_000]]
    assert alone.news_ns.tolist() == [[26_470_000, 26_605_000, 26_740_000, 26_875_000]]
    assert alone.refresh_ns.tolist() == [[502_470_000, 502_605_000, 502_740_000, 502_875_000]]
    assert alone.settled_ns == (3_875_000, 3_875_000 + 4_000_000 + 4_415_000)


@pytest.mark.parametrize(
    ("nodes", "coarse_ns", "fine_ns"),
    [
        (56, 33_575_000, 33_575_000 + 4_000_000 + 63_815_000),
        (57, 34_115_000, UNBOUNDED),
        (112, 63_815_000, UNBOUNDED),
        (113, UNBOUNDED, UNBOUNDED),
    ],
)
def test_more_frames_than_fit_between_two_refreshes_have_no_bound(nodes: int, coarse_ns: int, fine_ns: int) -> None:
    """Coarse frames of all take 3,335 + 540 µs a node, refreshes and fine frames twice that, of 64 ms."""
    assert of_nodes(nodes).settled_ns == (coarse_ns, fine_ns)


def test_on_can_fd_a_node_has_one_frame_and_waits_twice_for_details() -> None:
    shapes = frames(2)
    shapes["length"], shapes["flags"] = (32, 64), FD | BRS
    coarse_ns, fine_ns = frame_time_ns(shapes, 500_000, 600_000, "worst").tolist()
    alone = of_nodes(1, fd=True)
    assert (alone.coarse_frame_ns, alone.frame_ns, alone.frames_of_node) == (coarse_ns, fine_ns, 1)
    before_ns = 130_000 + 2_000_000 + 2 * fine_ns  # SYNC, its pause, a frame on its way then and at the end of it
    assert alone.top_ns.tolist() == [[before_ns + coarse_ns]]
    shown_ns, late_ns = before_ns + coarse_ns + MS, before_ns + 2 * fine_ns + MS
    assert alone.settled_ns == (shown_ns, shown_ns + 2 * 4 * MS + late_ns)


def test_heartbeats_and_answers_wait_for_the_room_of_a_pause() -> None:
    """A pause has room for 2,000 - 135 - 65 = 1,800 µs; it begins 98,200 µs after the one before ended.

    The first heartbeat waits for one of 65 µs, the 27th for 27. For the 28th, 20 µs are left to the second pause, for
    the last 215 µs. With errors (166 µs each 100 ms) and two SDO transfers in 100 ms (135 µs each frame) ahead, and
    jitter, the answer waits for the request, too.
    """
    beats_ns = bounds().service_ns[1:]
    assert [int(beats_ns[place]) for place in (0, 1, 26, 27, 30, 31)] == [
        98_200_000 + 65_000 + 65_000,
        98_200_000 + 2 * 65_000 + 65_000,
        98_200_000 + 27 * 65_000 + 65_000,
        198_200_000 + 20_000 + 65_000,
        198_200_000 + 215_000 + 65_000,
        198_200_000 + 215_000 + 65_000,
    ]
    assert bounds(ROUGH).service_ns[1:4].tolist() == [
        98_700_000 + 166_000 + 135_000 + 135_000,
        98_700_000 + 166_000 + 2 * 135_000 + 65_000 + 135_000,
        98_700_000 + 166_000 + 4 * 135_000 + 65_000 + 65_000,
    ]


@pytest.mark.parametrize(("bits_per_s", "saved_bits"), [(4_000, 8 * 135), (5_000, 1_250), (24_000, 6_000)])
def test_a_node_saves_up_a_quarter_of_a_second_or_eight_frames(bits_per_s: int, saved_bits: int) -> None:
    budgeted = Budgeted(bounds(), bits_per_s)
    assert (budgeted.frame_bits, budgeted.saved_bits) == (135, saved_bits)


def test_a_budget_makes_a_node_alone_wait_for_its_bits() -> None:
    """At 24 kbit/s a frame takes 5,625 µs of budget. The bus is full for 6,000 bits saved up, 540 owed, a frame on its
    way and a pause, longer by the 2.4 % of the budget and the 2.2 % of the pauses.

    Coarse: five frames are owed, and while the last group waits the three others come four times in 24 ms each:
    (5 + 4 * 3 + 1) frames. Fine: 8 + 4 + 1 frames.
    """
    budgeted = Budgeted(of_nodes(1), 24_000)
    assert budgeted.full_ns == round((6_000 + 540 + 135 + 2_200) * 1000 / (1 - 0.024 - 0.022))
    assert budgeted.coarse_ns == 24_000_000 + 18 * 5_625_000 + 2_875_000
    assert budgeted.fine_ns == 4_000_000 + 13 * 5_625_000 + budgeted.full_ns
    rough = Budgeted(of_nodes(1, ROUGH), 24_000)
    at_once_us = 6_000 + 540 + 135 + 2_200 * 1.005 + 166 * 1.00135
    assert rough.full_ns == pytest.approx(at_once_us * 1000 / (1 - 0.024 - 0.022 - 0.00166), abs=1)
    assert rough.fine_ns == 4_000_000 + 13 * 5_625_000 + 500_000 + rough.full_ns
