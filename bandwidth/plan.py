"""The plan of a skin's buses, from its layout: load, highest rate, window and response times.

The slots of stepped boards are planned as cycles in which every board sends. What boards send less is told as the load
at rest and under simulated touches.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import fmean
from typing import Final

import numpy as np
import numpy.typing as npt

from bandwidth.mean_bits import mean_wire_bits
from bandwidth.response import UNBOUNDED
from bandwidth.slots import slot_responses_ns
from bandwidth.touched_bits import touched_bits
from bandwidth.traffic import Disturbance, Traffic, traffic
from dbc.contract import Contract, sync_frame
from dbc.dictionary import window_s
from dbc.frame_bits import Stuffing, frame_time_ns, wire_bits
from skin.choice import ROOM
from skin.layout import Bus, Layout, validated
from skin.sources import load_objects
from skin.sync_counter import SYNC_OVERFLOW

#: Bytes that Linux counts for one received frame (struct sk_buff, a small page fragment, padding), rounded up.
RECEIVED_FRAME_BYTES: Final = 896
#: Cycles in the receive buffer of a reader that was delayed by one cycle.
CYCLES_BUFFERED: Final = 2
#: Length of the simulated touches of stepped boards.
TOUCHED_S: Final = 16.0


@dataclass(frozen=True)
class NodePlan:
    """One node: TPDOs per cycle, and longest time from SYNC to the end of the last TPDO; None without a bound.

    The time of a stepped node is that from its sample.
    """

    node_id: int
    frames_per_cycle: int
    response_ms: float | None


@dataclass(frozen=True)
class ForeignPlan:
    """One message of another device: its period, and longest time until its frame has ended; None without a bound."""

    name: str
    identifier: int
    is_extended: bool
    period_ms: float
    response_ms: float | None


@dataclass(frozen=True)
class BusPlan:
    """One bus at the layout's SYNC rate, or rate of slots.

    Names tell the payloads: ``touched`` the sums of a simulated touched skin, None without simulation; ``random``
    random bits, as in published tables; ``worst`` the most stuff bits. Bits are those of one cycle with its SYNC. Loads
    and rates include SYNC and heartbeats; a rate that ends in ``_80`` is for a load of 80 %. Times are upper bounds,
    None if the bus is too full for a bound.

    Of stepped boards: a cycle is a slot, and has no SYNC; the window is the length of the slot, and of it the time
    from a sample to the end of its frame is needed if all boards send, `late_random_ms` with random bits. ``rest`` is
    what boards send while nothing touches. Of other boards these two are None. If the longest frames of all slots ask
    for more than the bus, SDO, heartbeats and other devices have bounds with random bits, if any.
    """

    name: str
    nodes: int
    bitrate: int
    data_bitrate: int | None
    frames_per_cycle: int
    bits_per_cycle_touched: float | None
    bits_per_cycle_random: float
    bits_per_cycle_worst: int
    load_rest: float | None
    load_touched: float | None
    load_random: float
    load_worst: float
    max_rate_hz_random: float
    max_rate_hz_touched: float | None
    max_rate_hz_worst: float
    max_rate_hz_random_80: float
    max_rate_hz_worst_80: float
    window_ms: float
    window_needed_ms: float | None
    late_random_ms: float | None
    sdo_response_ms: float | None
    heartbeat_response_ms: float | None
    receive_buffer_frames: int
    receive_buffer_bytes: int
    node_plans: list[NodePlan]
    foreign: list[ForeignPlan]
    problems: list[str]


@dataclass(frozen=True)
class BusTime:
    """Time and bits of one cycle on a bus, and time of heartbeats, TIME and other devices in one second."""

    cycle_s: float
    cycle_bits: float
    beats_s: float

    def load(self, rate_hz: float) -> float:
        """Return the load of the bus at `rate_hz`."""
        return self.cycle_s * rate_hz + self.beats_s

    def rate_hz(self, part: float = 1.0) -> float:
        """Return the rate at which the load is `part`."""
        return max(0.0, (part - self.beats_s) / self.cycle_s)


def plan(contract: Contract, *, allowed: Disturbance | None = None, is_touched: bool = True) -> list[BusPlan]:
    """Plan every bus of a skin.

    Parameters
    ----------
    allowed : Disturbance, optional
        Disturbances that response times include.
    is_touched : bool
        Whether to simulate a touch of stepped boards, which takes seconds.
    """
    allowed = allowed or Disturbance()
    buses = range(len(contract.layout.bus))
    if not contract.in_steps:
        bits = touched_bits(contract)
        return [plan_bus(contract, bus, bits[bus].mean(axis=0), allowed) for bus in buses]
    kinds = [(line.fd, line.bitrate, line.data_bitrate) for line in contract.layout.bus]
    # Neighbouring patches are on different buses, so that one bus stands for all like it: the first.
    loads = {kind: touched_load(contract, kinds.index(kind)) if is_touched else None for kind in set(kinds)}
    plans = []
    for bus, kind in enumerate(kinds):
        planned, touched = plan_bus(contract, bus, None, allowed), loads[kind]
        if touched is not None:
            idle = random_bus_time(traffic(contract, bus)).beats_s
            planned = replace(planned, load_touched=min(1.0, idle + touched))
        plans.append(planned)
    return plans


def planned(layout: Layout, allowed: Disturbance) -> list[BusPlan]:
    """Check and plan a layout that a program has built, without simulated touches."""
    contract = Contract.from_layout(validated(layout))
    return [plan_bus(contract, bus, None, allowed) for bus in range(len(layout.bus))]


def touched_load(contract: Contract, bus: int) -> float:
    """Return the load of the sums of a bus of stepped boards while the default objects press and slide."""
    from nodes.steps.simulated import touched_frames  # compiled parts take a moment to load

    line = contract.layout.bus[bus]
    sent = touched_frames(contract, bus, load_objects(contract.layout, seed=0), TOUCHED_S)
    return float(frame_time_ns(sent, line.bitrate, line.data_bitrate).sum()) * 1e-9 / TOUCHED_S


def cycle_hz(layout: Layout) -> float:
    """Return how many cycles, or slots of stepped boards, there are in a second."""
    return layout.sync.rate_hz if layout.sends.in_cycles else 1 / layout.steps.slot_s


def plan_bus(contract: Contract, bus: int, touched: npt.NDArray[np.float64] | None, allowed: Disturbance) -> BusPlan:
    """Plan one bus; `touched` holds the mean nominal and data bits of the TPDOs of a simulated touched skin."""
    layout, line = contract.layout, contract.layout.bus[bus]
    turns = [traffic(contract, bus, turn, allowed) for turn in range(contract.turns)]
    random = [random_bus_time(each) for each in turns]
    worst = max((bus_time(each, "worst") for each in turns), key=lambda each: each.cycle_bits)
    felt = None if touched is None else _mean_bus_time(turns[0], touched)
    rate_hz = cycle_hz(layout)
    found = [each.responses_ns(allowed.errors_per_s) for each in turns]
    last, rest, late_random_ms = turns[0], None, None
    if contract.in_steps:
        if worst.load(rate_hz) > 1:
            found = [last.responses_ns(allowed.errors_per_s, _random_ns(last))]
        found[0][last.is_tpdo] = slot_responses_ns(contract, last, last.worst_ns, allowed)
        late_random_ms = milliseconds(slot_responses_ns(contract, last, _random_ns(last), allowed))
        rest = random[0].load(rate_hz / contract.keep_max)
    # Messages of other devices have other places in each turn.
    ours = [each[~streams.is_foreign] for each, streams in zip(found, turns, strict=True)]
    # A node with one frame has none in the second turn.
    ours = [each for each in ours if len(each) == len(ours[0])]
    theirs = [each[streams.is_foreign] for each, streams in zip(found, turns, strict=True)]
    responses = np.zeros(len(found[0]), np.int64)
    responses[~last.is_foreign] = np.max(ours, axis=0)
    nodes = _node_plans(last, responses)
    foreign = foreign_plans(last, np.max(theirs, axis=0))
    window_ms = 1e3 * (layout.steps.slot_s if contract.in_steps else window_s(layout))
    per_cycle = int(last.is_cyclic.sum())
    others = CYCLES_BUFFERED * layout.sync.period_s / last.period_s[last.is_foreign]
    cycles = CYCLES_BUFFERED * rate_hz * layout.sync.period_s
    buffered = math.ceil(cycles * per_cycle) + line.nodes + int(np.ceil(others).sum())
    needed = milliseconds(responses[last.is_tpdo])
    problems = _problems(line, worst, rate_hz, needed, window_ms, sends=bool(nodes))
    if contract.in_steps:
        problems = _slot_problems(contract, bus, worst)
    return BusPlan(
        name=line.name,
        nodes=line.nodes,
        bitrate=line.bitrate,
        data_bitrate=line.data_bitrate,
        frames_per_cycle=per_cycle,
        bits_per_cycle_touched=None if felt is None else felt.cycle_bits,
        bits_per_cycle_random=fmean(each.cycle_bits for each in random),
        bits_per_cycle_worst=round(worst.cycle_bits),
        load_rest=rest,
        load_touched=None if felt is None else felt.load(rate_hz),
        load_random=fmean(each.load(rate_hz) for each in random),
        load_worst=worst.load(rate_hz),
        max_rate_hz_random=fmean(each.rate_hz() for each in random),
        max_rate_hz_touched=None if felt is None else felt.rate_hz(),
        max_rate_hz_worst=worst.rate_hz(),
        max_rate_hz_random_80=fmean(each.rate_hz(ROOM) for each in random),
        max_rate_hz_worst_80=worst.rate_hz(ROOM),
        window_ms=window_ms,
        window_needed_ms=needed,
        late_random_ms=late_random_ms,
        sdo_response_ms=milliseconds(responses[last.is_sdo_response]),
        heartbeat_response_ms=milliseconds(responses[last.is_heartbeat]),
        receive_buffer_frames=buffered,
        receive_buffer_bytes=buffered * RECEIVED_FRAME_BYTES,
        node_plans=nodes,
        foreign=foreign,
        problems=[*problems, *(late_foreign(line, foreign) if worst.load(rate_hz) <= 1 else ())],
    )


def foreign_plans(streams: Traffic, responses: npt.NDArray[np.int64]) -> list[ForeignPlan]:
    """Return the plans of the messages of other devices; `responses` are theirs, by priority, nanoseconds."""
    messages = [each for each in streams.foreign if each is not None]
    return [
        ForeignPlan(each.name, *each.key, (each.period_s or 0.0) * 1e3, milliseconds(response))
        for each, response in zip(messages, responses.tolist(), strict=True)
    ]


def late_foreign(bus: Bus, foreign: Sequence[ForeignPlan]) -> list[str]:
    """Name the messages of other devices that may end after the next of their name is due."""
    return [
        f"{bus.name}: '{each.name}' of another device"
        + (
            " has no bound"
            if each.response_ms is None
            else f" may take {each.response_ms:.2f} ms, and comes every {each.period_ms:.2f} ms"
        )
        for each in foreign
        if each.response_ms is None or each.response_ms > each.period_ms
    ]


def bus_time(streams: Traffic, stuffing: Stuffing) -> BusTime:
    """Return the bus time of `streams`, without or with the most stuff bits."""
    cyclic = streams.frames[streams.is_cyclic]
    nominal, data = wire_bits(cyclic, stuffing)
    return _bus_time(streams, float(nominal.sum()), float(data.sum()), stuffing)


def random_bus_time(streams: Traffic) -> BusTime:
    """Return the mean bus time of `streams` with random data bits in TPDOs."""
    return _mean_bus_time(streams, _random_bits(streams).sum(axis=0))


def _random_bits(streams: Traffic) -> npt.NDArray[np.float64]:
    """Return the mean nominal and data bits of each TPDO with random data."""
    tpdos = streams.frames[streams.is_tpdo]
    shapes = zip(tpdos["length"].tolist(), tpdos["flags"].tolist(), tpdos["can_id"].tolist(), strict=True)
    return np.array([mean_wire_bits(*shape) for shape in shapes]).reshape(-1, 2)


def _random_ns(streams: Traffic) -> npt.NDArray[np.int64]:
    """Return the time of each frame: the mean of random data for TPDOs, the longest for others."""
    times, bus = streams.worst_ns, streams.bus
    nominal, data = _random_bits(streams).T
    times[streams.is_tpdo] = np.rint(1e9 * (nominal / bus.bitrate + data / (bus.data_bitrate or bus.bitrate)))
    return times


def _sync_bits() -> float:
    """Return the bits of a SYNC frame as the mean of all counters."""
    syncs = np.concatenate([sync_frame(counter) for counter in range(1, SYNC_OVERFLOW + 1)])
    return float(wire_bits(syncs)[0].mean())


def _mean_bus_time(streams: Traffic, tpdo_bits: npt.NDArray[np.float64]) -> BusTime:
    """Add SYNC, heartbeats, TIME and other devices to the mean bits of the TPDOs."""
    sync_bits = _sync_bits() * (streams.is_cyclic.sum() - streams.is_tpdo.sum())
    return _bus_time(streams, float(tpdo_bits[0] + sync_bits), float(tpdo_bits[1]), "exact")


def _bus_time(streams: Traffic, nominal: float, data: float, stuffing: Stuffing) -> BusTime:
    bus = streams.bus
    beats = streams.has_own_period
    beat_bits, fast_bits = wire_bits(streams.frames[beats], stuffing)
    data_bitrate = bus.data_bitrate or bus.bitrate
    return BusTime(
        cycle_s=nominal / bus.bitrate + data / data_bitrate,
        cycle_bits=nominal + data,
        beats_s=float(((beat_bits / bus.bitrate + fast_bits / data_bitrate) / streams.period_s[beats]).sum()),
    )


def _node_plans(streams: Traffic, responses: npt.NDArray[np.int64]) -> list[NodePlan]:
    plans = []
    for node_id in np.unique(streams.node[streams.is_tpdo]).tolist():
        mine = streams.is_tpdo & (streams.node == node_id)
        plans.append(NodePlan(node_id, int(mine.sum()), milliseconds(responses[mine])))
    return plans


def _problems(
    bus: Bus, worst: BusTime, rate_hz: float, needed_ms: float | None, window_ms: float, *, sends: bool
) -> list[str]:
    """Say what does not fit; a bus none of whose blocks sends sums has no TPDOs that could be late."""
    load = worst.load(rate_hz)
    found = []
    if load > 1:
        missing = (load - 1) * bus.bitrate
        found.append(
            f"{bus.name}: frames with the most stuff bits ask for {load:.1%} of the bus; "
            f"{missing:.0f} bits a second are missing at {rate_hz:g} Hz, {worst.rate_hz():.1f} Hz would fit"
        )
    if needed_ms is None and load <= 1 and sends:
        found.append(f"{bus.name}: with SDO transfers and errors, the last TPDOs have no bound")
    if needed_ms is not None and needed_ms > window_ms:
        found.append(
            f"{bus.name}: the last TPDO may end {needed_ms:.2f} ms after SYNC, "
            f"but the window (1007h) is {window_ms:.2f} ms; {needed_ms - window_ms:.2f} ms are missing: fewer sums,"
            " more buses, or `device.jitter_s` (--jitter-s) of your boards where it is shorter"
        )
    return found


def _slot_problems(contract: Contract, bus: int, worst: BusTime) -> list[str]:
    """Say what does not fit if every board sends in every slot, as boards with a `quiet` of 0 do."""
    steps, line, load = contract.layout.steps, contract.layout.bus[bus], worst.load(cycle_hz(contract.layout))
    if steps.quiet > 0 or load <= 1:
        return []
    most_hz = max(worst.rate_hz(), 1e-9)
    would = f"{1 / most_hz:.4f} s or more, or {math.floor(line.nodes * most_hz * steps.slot_s)} nodes on the bus"
    asked = f"{line.nodes} nodes in slots of {steps.slot_s:g} s ask for {load:.1%} of the bus"
    return [f"{line.name}: {asked} with the most stuff bits: expected `steps.slot_s` of {would}"]


def milliseconds(responses_ns: "npt.NDArray[np.int64] | int") -> float | None:
    """Return the longest of some response times, None without a bound."""
    longest = int(np.max(responses_ns, initial=0))
    return longest * 1e-6 if 0 < longest < UNBOUNDED else None
