"""Response times of whole buses: a published table, turns, and the arbitrated bus as judge."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bandwidth.traffic import Disturbance, Traffic, traffic
from bus.simulated_bus import SimulatedBus
from dbc.contract import Contract
from dbc.frame import frames
from skin.layout import Layout, changed, load_layout
from tests.layouts import STEPPED, buses, in_one_instant, small_layout


def skin(nodes: list[int], rate_hz: float, bits: int = 14) -> Contract:
    """One block of 8 sums per node, which answers at once; what the first bus leaves of 128 blocks is on a second."""
    tables = {"sync": {"rate_hz": rate_hz}, "encoding": {"sum_bits": bits}, "device": {"jitter_s": 1e-4}}
    return Contract.from_layout(small_layout(64, 64, **tables, bus=buses(*nodes)))


@pytest.mark.parametrize(
    ("nodes", "bits", "period_ms", "worst", "plain_ms", "error_ms", "sdo_ms"),
    [
        ([32, 96], 14, 10, 0.878, 8.94, 9.11, 8.97),
        ([32, 96], 10, 8, 0.936, 7.66, 7.83, 7.70),
        ([32, 96], 7, 5, 0.884, 4.62, 4.79, 4.66),
        ([64, 64], 14, 20, 0.877, 17.58, 17.91, 17.61),
        ([127, 1], 14, 40, 0.873, 34.59, 35.25, 34.62),
        ([127, 1], 7, 20, 0.874, 17.45, 17.78, 17.48),
    ],
)
def test_published_table(
    nodes: list[int], bits: int, period_ms: float, worst: float, plain_ms: float, error_ms: float, sdo_ms: float
) -> None:
    """Its frames of four sums of 16 and 12 bits and of eight of 8 bits have 8, 6 and 8 bytes, as those here have."""
    contract = skin(nodes, 1000 / period_ms, bits)
    streams = traffic(contract, 0)
    assert (streams.worst_ns / streams.period_s).sum() * 1e-9 == pytest.approx(worst, rel=0.01)
    plain, disturbed = streams.responses_ns() * 1e-6, streams.responses_ns(100.0) * 1e-6
    assert plain[streams.is_tpdo].max() == pytest.approx(plain_ms, rel=0.01)
    assert disturbed[streams.is_tpdo].max() == pytest.approx(error_ms, rel=0.01)
    assert plain[streams.is_sdo_response].max() == pytest.approx(sdo_ms, rel=0.01)


def test_streams_are_all_that_the_bus_carries() -> None:
    contract = Contract.from_layout(in_one_instant())
    streams = traffic(contract, 3)
    assert list(streams.frames["can_id"]) == sorted(streams.frames["can_id"])
    assert len(streams.frames) == 1 + 64 + 2 + 32
    assert len(traffic(Contract.from_layout(load_layout()), 3).frames) == 1 + 32 + 2 + 32
    assert streams.is_heartbeat.sum() == 32
    assert set(streams.node[streams.is_tpdo]) == set(range(1, 33))
    assert (streams.node[streams.is_sdo_response] == 32).all()
    assert not traffic(contract, 3, 0, Disturbance(sdo_per_s=0)).is_sdo_response.any()


@pytest.mark.parametrize(("name", "turns"), [("default", 1), ("default", 2), ("fd", 1), ("one-bus-12bit", 1)])
def test_a_simulated_bus_stays_below_every_bound(name: str, turns: int) -> None:
    """Five cycles with every SDO and heartbeat at the first SYNC, random data, and the slowest nodes last."""
    layout = changed(load_layout(Path(name)), sync={"turns": turns}, device={"jitter_s": 1e-4})
    contract = Contract.from_layout(layout)
    streams = [traffic(contract, 0, turn) for turn in range(contract.turns)]
    bound = {
        int(f["can_id"]): int(r) for each in streams for f, r in zip(each.frames, each.responses_ns(), strict=True)
    }
    random = np.random.default_rng(3)
    bus = SimulatedBus(layout.bus[0].bitrate, layout.bus[0].data_bitrate)
    sender, listener = bus.attach("sender", queue_size=10_000), bus.attach("listener")
    bus.submit(listener, frames(0))
    period_ns = round(layout.sync.period_s * 1e9)
    event: dict[int, list[int]] = {}
    for cycle in range(5):
        burst = released(streams[cycle % contract.turns], random, 1_000_000 + cycle * period_ns, first=cycle == 0)
        for can_id in burst["can_id"].tolist():
            event.setdefault(can_id, []).append(1_000_000 + cycle * period_ns)
        assert bus.submit(sender, burst) == len(burst)
    latest = 0.0
    for frame in bus.run_until().frames:
        can_id = int(frame["can_id"])
        took = int(frame["time_ns"]) - event[can_id].pop(0)
        assert took <= bound[can_id], hex(can_id)
        latest = max(latest, took / bound[can_id])
    assert not any(event.values())
    assert latest > 0.75  # random data is shorter than the worst


def released(streams: Traffic, random: np.random.Generator, time_ns: int, *, first: bool) -> np.ndarray:
    burst = streams.frames[streams.is_cyclic | first]
    tpdo = streams.is_tpdo[streams.is_cyclic | first]
    burst["time_ns"] = time_ns + tpdo * random.integers(0, 100_001, len(burst))
    burst["port"] = np.arange(len(burst))
    for frame in burst:
        frame["data"][: frame["length"]] = random.integers(0, 256, int(frame["length"]))
    return burst[np.argsort(burst["time_ns"], kind="stable")]


#: Three nodes of two TPDOs with 8 bytes, TIME every minute.
def small_layout_with_time(**tables: Any) -> Layout:
    return small_layout(8, 16, **tables, sync={"rate_hz": 10.0, "time_s": 60.0}, bus=buses(3, 1, names=("arm", "hand")))


def small(allowed: Disturbance | None = None) -> Traffic:
    return traffic(Contract.from_layout(small_layout_with_time()), 0, allowed=allowed)


def test_each_stream_has_its_sender_its_period_and_its_jitter() -> None:
    """SDO transfers are those with the last node, 20 a second; heartbeats come once a second."""
    streams = small()
    tpdos = [0x181, 0x182, 0x183, 0x281, 0x282, 0x283]
    assert streams.frames["can_id"].tolist() == [0x80, 0x100, *tpdos, 0x583, 0x603, 0x701, 0x702, 0x703]
    assert streams.frames["length"].tolist() == [1, 6, *[8] * 6, 8, 8, 1, 1, 1]
    assert streams.frames["data"][-3:, 0].tolist() == [5, 5, 5]
    assert streams.node.tolist() == [0, 0, 1, 2, 3, 1, 2, 3, 3, 0, 1, 2, 3]
    assert streams.period_s.tolist() == [0.1, 60, *[0.1] * 6, 0.05, 0.05, 1, 1, 1]
    assert streams.jitter_s.tolist() == [0, 0, *[1e-3] * 6, 0, 0, 0, 0, 0]
    for name, true in (
        ("is_cyclic", [0, *range(2, 8)]),
        ("is_tpdo", range(2, 8)),
        ("is_heartbeat", range(10, 13)),
        ("has_own_period", [1, *range(10, 13)]),
        ("is_sdo_response", [8]),
    ):
        assert np.flatnonzero(getattr(streams, name)).tolist() == list(true), name
    assert streams.worst_ns.tolist() == [x * 1000 for x in (65, 115, *[135] * 8, 65, 65, 65)]


def test_the_response_to_the_last_node_id_is_an_sdo_response() -> None:
    """0x580 + 1 is the first of all nodes, 0x580 + 127 the last."""
    for nodes, can_id in ((1, 0x581), (127, 0x5FF)):
        streams = traffic(skin([nodes, 128 - nodes], 1.0), 0)
        assert streams.frames["can_id"][streams.is_sdo_response].tolist() == [can_id]


def test_a_response_waits_for_what_is_more_urgent_and_one_frame_on_its_way() -> None:
    """TPDOs 1 ms after SYNC; a TPDO of the cycle before may be on its way whatever its priority. An error every
    millisecond costs the longest frame before it and 31 bits.
    """
    waits = small(Disturbance(jitter_s=1e-3, sdo_per_s=0.0)).responses_ns()
    assert waits[0] == 135_000 + 65_000
    assert waits[1] == 135_000 + 65_000 + 115_000
    assert waits[2:8].tolist() == [1_000_000 + 135_000 + 65_000 + 115_000 + each * 135_000 for each in range(1, 7)]
    with_errors = small(Disturbance(jitter_s=1e-3, sdo_per_s=0.0, errors_per_s=100.0)).responses_ns(100.0)
    assert with_errors[7] - waits[7] == 135_000 + 31_000


@pytest.mark.parametrize(
    ("tables", "jitter_s"), [({}, 1e-3), ({"device": {"jitter_s": 2e-4}}, 2e-4), (STEPPED, 100e-6)]
)
def test_boards_answer_as_the_layout_says_and_stepped_ones_at_once(tables: dict[str, Any], jitter_s: float) -> None:
    layout = small_layout_with_time(**tables)
    assert Disturbance().of(layout) == Disturbance(jitter_s=jitter_s, sdo_per_s=20.0, errors_per_s=0.0)
    given = Disturbance(jitter_s=0.0, errors_per_s=3.0)
    assert given.of(layout) is given
