"""Response times of whole buses: a published table, phases, and the arbitrated bus as judge."""

from pathlib import Path

import numpy as np
import pytest

from bandwidth.traffic import Disturbance, Traffic, traffic
from bus.simulated_bus import SimulatedBus
from dbc.contract import Contract
from dbc.frame import frames
from skin.layout import load_layout, parse_layout


def skin(nodes: list[int], rate_hz: float, bits: int) -> bytes:
    """One block of 8 sums per node; what the first bus leaves of 128 blocks is on a second."""
    buses = [f'[[bus]]\nname = "bus{i}"\nnodes = {each}\n' for i, each in enumerate(nodes)]
    return (
        f'[sync]\nrate_hz = {rate_hz}\nidentity = "alternating"\n[encoding]\nsum_bits = {bits}\n'.encode()
        + "".join(buses).encode()
    )


@pytest.mark.parametrize(
    ("nodes", "bits", "period_ms", "worst", "plain_ms", "error_ms", "sdo_ms"),
    [
        ([32, 96], 16, 10, 0.878, 8.94, 9.11, 8.97),
        ([32, 96], 12, 8, 0.936, 7.66, 7.83, 7.70),
        ([32, 96], 8, 5, 0.884, 4.62, 4.79, 4.66),
        ([64, 64], 16, 20, 0.877, 17.58, 17.91, 17.61),
        ([127, 1], 16, 40, 0.873, 34.59, 35.25, 34.62),
        ([127, 1], 8, 20, 0.874, 17.45, 17.78, 17.48),
    ],
)
def test_published_table(
    nodes: list[int], bits: int, period_ms: float, worst: float, plain_ms: float, error_ms: float, sdo_ms: float
) -> None:
    contract = Contract.from_layout(parse_layout(skin(nodes, 1000 / period_ms, bits), "table"))
    streams = traffic(contract, 0)
    assert (streams.worst_ns / streams.period_s).sum() * 1e-9 == pytest.approx(worst, rel=0.01)
    plain, disturbed = streams.responses_ns() * 1e-6, streams.responses_ns(100.0) * 1e-6
    assert plain[streams.is_tpdo].max() == pytest.approx(plain_ms, rel=0.01)
    assert disturbed[streams.is_tpdo].max() == pytest.approx(error_ms, rel=0.01)
    assert plain[streams.is_sdo_response].max() == pytest.approx(sdo_ms, rel=0.01)


def test_streams_are_all_that_the_bus_carries() -> None:
    contract = Contract.from_layout(load_layout())
    streams = traffic(contract, 3)
    assert list(streams.frames["can_id"]) == sorted(streams.frames["can_id"])
    assert len(streams.frames) == 1 + 64 + 2 + 32
    assert streams.is_heartbeat.sum() == 32
    assert set(streams.node[streams.is_tpdo]) == set(range(1, 33))
    assert (streams.node[streams.is_sdo_response] == 32).all()
    assert not traffic(contract, 3, 0, Disturbance(sdo_per_s=0)).is_sdo_response.any()


@pytest.mark.parametrize("name", ["default", "fd", "one-bus-12bit"])
def test_a_simulated_bus_stays_below_every_bound(name: str) -> None:
    """Five cycles with every SDO and heartbeat at the first SYNC, random data, and the slowest nodes last."""
    layout = load_layout(Path(name))
    contract = Contract.from_layout(layout)
    phases = [traffic(contract, 0, phase) for phase in range(contract.phases)]
    bound = {int(f["can_id"]): int(r) for each in phases for f, r in zip(each.frames, each.responses_ns(), strict=True)}
    random = np.random.default_rng(3)
    bus = SimulatedBus(layout.bus[0].bitrate, layout.bus[0].data_bitrate)
    sender, listener = bus.attach("sender", queue_size=10_000), bus.attach("listener")
    bus.submit(listener, frames(0))
    period_ns = round(layout.sync.period_s * 1e9)
    event: dict[int, list[int]] = {}
    for cycle in range(5):
        burst = released(phases[cycle % contract.phases], random, 1_000_000 + cycle * period_ns, first=cycle == 0)
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
