"""The model of the buses against the arbitrated bus, frame by frame."""

from dataclasses import replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from bus.simulated_bus import SimulatedBus
from dbc.adaptive import FIRST_COB_ID, NODES, TPDOS
from dbc.contract import Contract
from dbc.frame import Frames, frames
from dbc.frame_bits import frame_time_ns
from evaluation.schemes.adaptive import run_adaptive
from evaluation.schemes.events import run_events
from evaluation.schemes.scan import run_scan
from evaluation.schemes.sums import run_sums
from evaluation.schemes.wire import TICK_NS, Asked, Sent, carry
from skin.layout import Bus, load_layout

NEWTON_PER_COUNT = 0.02 / 1023


def arbitrated(sent: Sent, number: int) -> dict[tuple[int, int], list[int]]:
    """Send one bus's frames on the arbitrated bus; return when those of each identifier and first byte ended."""
    line = sent.lines[number]
    mine = np.flatnonzero(sent.asked.bus == number)
    mine = mine[np.argsort(sent.asked.time_ns[mine], kind="stable")]
    wire = SimulatedBus(line.bitrate, line.data_bitrate)
    nodes = wire.attach("nodes", queue_size=len(mine) + 1)
    wire.attach("gateway")
    burst = sent.asked.frames[mine].copy()
    # A time of 0 would mean now; the bus starts one second later than the model.
    burst["time_ns"] = sent.asked.time_ns[mine] + 1_000_000_000
    burst["port"] = burst["can_id"]
    assert wire.submit(nodes, burst) == len(burst)
    ended = wire.run_until().frames
    assert wire.counts.errors == 0
    return order(ended, ended["time_ns"] - 1_000_000_000)


def order(sent: Frames, times: np.ndarray) -> dict[tuple[int, int], list[int]]:
    found: dict[tuple[int, int], list[int]] = {}
    for can_id, first, time_ns in sorted(
        zip(sent["can_id"].tolist(), sent["data"][:, 0].tolist(), times.tolist(), strict=True)
    ):
        found.setdefault((can_id, first), []).append(time_ns)
    return found


def same(sent: Sent) -> None:
    for number in range(len(sent.lines)):
        mine = sent.asked.bus == number
        assert arbitrated(sent, number) == order(sent.asked.frames[mine], sent.arrived_ns[mine])


def felt(ticks: int, seed: int = 0) -> np.ndarray:
    """Return a third of all taxels pressed at once after 20 ms, with noise."""
    random = np.random.default_rng(seed)
    true = np.zeros((ticks, 4096), np.float32)
    true[20:, ::3] = 0.008
    noisy = true + random.standard_normal(true.shape, np.float32) * np.float32(1e-3)
    return np.clip(noisy, 0, np.float32(0.02))


def counts_of(felt_n: np.ndarray) -> np.ndarray:
    return np.rint(felt_n / NEWTON_PER_COUNT).astype(np.int16)


def test_bursts_of_events_end_when_the_arbitrated_bus_ends_them() -> None:
    run = run_events(counts_of(felt(60)), NEWTON_PER_COUNT, 3e-3)
    assert len(run.sent.asked) > 1000
    same(run.sent)


def test_scans_and_sums_end_when_the_arbitrated_bus_ends_them() -> None:
    same(run_scan(felt(60), 10, 45.0).sent)
    same(run_sums(Contract.from_layout(load_layout()), counts_of(felt(60))).sent)


def test_adaptive_sums_end_when_the_arbitrated_bus_ends_them() -> None:
    idle = np.random.default_rng(1).standard_normal((400, 4096), np.float32) * np.float32(1e-3)
    run = run_adaptive(counts_of(felt(150)), counts_of(np.maximum(idle, 0)))
    assert len(run.sent.asked) > 1500
    assert run.sent.traffic()["load_peak"] > 0.3
    # The identifier carries urgency, so that it changes while a frame waits: each has the one of its last tick.
    sent, frames = run.sent.asked, run.sent.asked.frames
    begun = run.sent.free_ns - frame_time_ns(frames, 1_000_000, 0)
    is_tpdo = (frames["can_id"] >= FIRST_COB_ID) & (frames["can_id"] < FIRST_COB_ID + NODES * TPDOS)
    times = np.where(is_tpdo, begun // TICK_NS * TICK_NS, sent.time_ns)
    same(replace(run.sent, asked=Asked(frames, sent.bus, times)))


@settings(max_examples=25, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 40), st.integers(0, 3_000_000), st.integers(0, 8)), min_size=1, max_size=60))
def test_any_frames_end_when_the_arbitrated_bus_ends_them(wanted: list[tuple[int, int, int]]) -> None:
    first = {can_id: (time_ns, length) for can_id, time_ns, length in wanted}  # an identifier has one sender
    sent = frames(len(first))
    sent["can_id"] = np.array(list(first)) + 0x180
    sent["length"] = [length for _, length in first.values()]
    times = np.array([time_ns for time_ns, _ in first.values()])
    lines = (Bus(name="one", nodes=1, bitrate=500_000),)
    same(carry([Asked(sent, np.zeros(len(sent), np.intp), times)], lines, 10))


def test_traffic_counts_every_bit_once() -> None:
    sent = frames(2)
    sent["can_id"], sent["length"] = (0x555, 0x556), 0
    lines = (Bus(name="one", nodes=1), Bus(name="two", nodes=1))
    carried = carry([Asked(sent, np.array([0, 1]), np.array([0, 0]))], lines, 200)
    took_ns = carried.free_ns - carried.asked.time_ns
    traffic = carried.traffic()
    # 47 bits without stuffing, and what CRC and identifier add; no heartbeat before 0.5 ms but one each after it.
    assert len(carried.asked) == 4
    assert traffic["kbit_per_s"] == took_ns.sum() / 1000 / 0.2 / 1e3
    assert traffic["load"] == max(took_ns[carried.asked.bus == bus].sum() for bus in (0, 1)) / 200e6
    assert traffic["load_peak"] == 2 * traffic["load"]
