"""Measured loads and departures, of a bus simulated frame by frame and then disturbed on purpose."""

import contextlib
from collections.abc import Callable

import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bandwidth.departures import departures, foreign
from bandwidth.measured import Identifiers, measure, misfits, planned_rates, whole_cycles
from bandwidth.plan import BusPlan, plan
from bus.simulated_bus import SimulatedBus
from canskin.errors import InputError
from dbc.contract import Contract
from dbc.frame import BRS, ERROR, EXTENDED, FD, REMOTE, Frames, frames
from skin.layout import Layout, changed, load_layout
from tests.gateway.drives import shared_contract
from tests.layouts import buses, in_turns, small_layout

CYCLES = 400
PERIOD_NS = 5_000_000


@pytest.fixture(scope="module")
def contract() -> Contract:
    """Return the default skin at twice its rate, in two turns, of boards that answer at once."""
    layout = in_turns(load_layout())
    return Contract.from_layout(changed(layout, sync={"rate_hz": 200.0}, device={"jitter_s": 1e-4}))


@pytest.fixture(scope="module")
def planned(contract: Contract) -> BusPlan:
    return plan(contract)[1]


@pytest.fixture(scope="module")
def healthy(contract: Contract) -> Frames:
    """Two seconds of bus 1 with random sums, as its gateway saw them."""
    wire = SimulatedBus(1_000_000)
    nodes, gateway = wire.attach("nodes", queue_size=1000), wire.attach("gateway")
    random = np.random.default_rng(1)
    seen = []
    for cycle in range(CYCLES + 1):
        burst = contract.cycle(1, cycle % contract.turns)
        burst["time_ns"] = 1 + cycle * PERIOD_NS
        burst["data"][1:, :8] = random.integers(0, 256, (len(burst) - 1, 8))
        burst["data"][0, 0] = cycle % 240 + 1
        burst["port"] = np.arange(len(burst))
        wire.submit(gateway, burst[:1])
        wire.submit(nodes, np.concatenate([burst[1:], beats(contract, cycle)]))
        seen.append(wire.run_until((cycle + 1) * PERIOD_NS).frames)
    return np.concatenate(seen)


def beats(contract: Contract, cycle: int) -> Frames:
    """Return the heartbeats of the nodes whose turn it is, one each second."""
    ids = [node.node_id for node in contract.on_bus(1) if node.node_id == cycle % 200]
    due = frames(len(ids))
    due["can_id"] = [0x700 + node_id for node_id in ids]
    due["length"], due["data"][:, 0], due["port"] = 1, 5, 500
    due["time_ns"] = 1 + cycle * PERIOD_NS
    return due


def left(contract: Contract, planned: BusPlan, seen: Frames) -> list[str]:
    return departures(contract, 1, seen, planned, measure(contract, 1, seen, planned))


def test_load_is_that_of_the_wire_and_adds_up(contract: Contract, planned: BusPlan, healthy: Frames) -> None:
    load = measure(contract, 1, healthy, planned)
    assert load.seconds == pytest.approx(CYCLES * PERIOD_NS * 1e-9, abs=1e-5)
    assert load.load_exact == pytest.approx(planned.load_random, rel=0.005)
    assert load.load_worst == pytest.approx(planned.load_worst, rel=0.001)
    assert sum(each.load_exact for each in load.nodes) == pytest.approx(load.load_exact)
    assert sum(each.frames for each in load.identifiers) == load.frames == CYCLES * 33 + 64
    assert [each.node_id for each in load.nodes] == list(range(33))
    for each in load.identifiers:
        assert each.planned_rate_hz == pytest.approx(each.rate_hz, rel=0.001)
    assert {each.kind for each in load.identifiers} == {"SYNC", "TPDO", "heartbeat"}


def test_a_healthy_bus_keeps_its_plan(contract: Contract, planned: BusPlan, healthy: Frames) -> None:
    assert left(contract, planned, healthy) == []


def drop(cob_id: int) -> Callable[[Frames], Frames]:
    return lambda seen: seen[seen["can_id"] != cob_id]


def put(place: int, cob_id: int, flags: int = 0, length: int = 8) -> Callable[[Frames], Frames]:
    def change(seen: Frames) -> Frames:
        one = seen[place : place + 1].copy()
        one["can_id"], one["flags"], one["length"] = cob_id, flags, length
        return np.insert(seen, place + 1, one)

    return change


def shorten(seen: Frames) -> Frames:
    changed = seen.copy()
    changed["length"][np.flatnonzero(seen["can_id"] == 0x183)[5]] = 7
    return changed


def delay(seen: Frames) -> Frames:
    changed = seen.copy()
    changed["time_ns"][np.flatnonzero(seen["can_id"] == 0x2A0)[3]] += 2_500_000
    return changed


def delay_cycle(seen: Frames) -> Frames:
    changed = seen.copy()
    first = int(np.flatnonzero(seen["can_id"] == 0x80)[10])
    changed["time_ns"][first + 1 : first + 33] += 2_000_000
    return changed


def slow(seen: Frames) -> Frames:
    changed = seen.copy()
    changed["time_ns"] *= 2
    return changed


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (drop(0x185), ["bus1: node 5: 200 TPDOs missing"]),
        (drop(0x705), ["bus1: node 5: no heartbeat for 2.0 s, one every 1000 ms was planned"]),
        (put(700, 0x123), ["bus1: 123h is not planned: 1 frames, 0.01% of the bus"]),
        (put(700, 0x721, length=1), ["bus1: 721h is not planned: 1 frames, 0.00% of the bus"]),
        (put(700, 0x1ABCDEF, EXTENDED), ["bus1: 01ABCDEFh is not planned: 1 frames, 0.01% of the bus"]),
        (put(700, 0x084), ["bus1: node 4 sent 1 emergencies"]),
        (put(700, 0x020, ERROR), ["bus1: 1 errors reported"]),
        (put(681, 0x186), ["bus1: node 6: 1 TPDOs came again in the same cycle"]),
        (put(681, 0x286), ["bus1: node 6: 1 TPDOs came in cycles of the other turn"]),
        (shorten, ["bus1: node 3: 1 TPDOs have another length or format"]),
        (delay, ["bus1: node 32: 1 TPDOs later than 4.62 ms after SYNC, the latest after"]),
        (delay_cycle, ["bus1: nodes 1-32: late TPDOs; node 32: 1 TPDOs later than 4.62 ms"]),
        (slow, ["bus1: SYNC every 10.000 ms, 5.000 ms were planned"]),
    ],
)
def test_what_left_the_plan_is_named(
    contract: Contract, planned: BusPlan, healthy: Frames, change: Callable[[Frames], Frames], said: list[str]
) -> None:
    found = left(contract, planned, change(healthy))
    assert all(any(line.startswith(wanted) for line in found) for wanted in said), found
    if change is not slow:
        assert len(found) == len(said), found


def test_a_missing_sync_is_named(contract: Contract, planned: BusPlan, healthy: Frames) -> None:
    places = np.flatnonzero(healthy["can_id"] == 0x80)
    found = left(contract, planned, np.delete(healthy, places[20]))
    assert "bus1: 1 SYNC counters do not follow each other" in found
    assert left(contract, planned, drop(0x80)(healthy)) == ["bus1: no SYNC: cycles cannot be told apart"]
    only = left(contract, planned, np.delete(healthy, places[1:]))
    assert only == ["bus1: one SYNC: cycles cannot be told apart"]


RECORDS = st.lists(
    st.tuples(
        st.integers(0, 2**40),
        st.sampled_from([0x80, 0x181, 0x281, 0x381, 0x701, 0x585, 0x7FF, 0x1ABCDEF]),
        st.integers(0, 8),
        st.sampled_from([0, 0, EXTENDED, REMOTE, ERROR, EXTENDED | ERROR]),
        st.integers(0, 255),
    ),
    max_size=30,
)


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(records=RECORDS)
def test_any_frames_are_compared_or_refused(
    contract: Contract, planned: BusPlan, records: list[tuple[int, ...]]
) -> None:
    seen = frames(len(records))
    for place, (time_ns, can_id, length, flags, counter) in enumerate(sorted(records)):
        seen["time_ns"][place], seen["can_id"][place], seen["length"][place] = time_ns, can_id, length
        seen["flags"][place] = flags | (EXTENDED if can_id > 0x7FF else 0)
        seen["data"][place, 0] = counter
    with contextlib.suppress(InputError):
        load = measure(contract, 1, seen, planned)
        assert all(line.startswith("bus1: ") for line in departures(contract, 1, seen, planned, load))
        assert load.load_exact <= load.load_worst


def test_can_fd_frames_on_a_classic_bus_are_refused(contract: Contract, planned: BusPlan, healthy: Frames) -> None:
    with pytest.raises(InputError, match=r"bus1: the layout has classic CAN there, but 1 of \d+ frames are CAN FD"):
        measure(contract, 1, put(700, 0x181, FD)(healthy), planned)
    slow = Contract.from_layout(small_layout(64, 64, bus=buses(32, names=["a"], blocks_per_node=4, fd=True)))
    with pytest.raises(InputError, match="a: the layout has CAN FD without a data bit rate there"):
        measure(slow, 0, put(700, 0x181, FD | BRS)(healthy), planned)


def test_frames_of_another_layout_are_noticed(contract: Contract, planned: BusPlan, healthy: Frames) -> None:
    def said(layout: Layout, seen: Frames) -> str:
        other = Contract.from_layout(layout)
        return " ".join(misfits(other, 0, seen, measure(other, 0, seen, planned)))

    assert misfits(contract, 1, healthy, measure(contract, 1, healthy, planned)) == []
    assert "identifiers that the layout does not plan; is 'skin' the layout of this skin?" in said(
        small_layout(16, 16), healthy
    )
    narrow = small_layout(64, 64, encoding={"sum_bits": 12})
    assert "TPDOs have another length or format" in said(narrow, healthy)
    slow = small_layout(64, 64, bus=buses(*4 * [32], bitrate=500_000))
    assert "more than a bus carries: its bit rate is not the layout's 500000" in said(slow, healthy)


def test_overload_is_named(contract: Contract, planned: BusPlan, healthy: Frames) -> None:
    flood = np.repeat(healthy[healthy["can_id"] == 0x285], 40, axis=0)
    found = left(contract, planned, np.insert(healthy, 700, flood))
    assert any("at most 87.9% were planned" in line for line in found)


def test_time_is_planned_if_the_layout_has_it(contract: Contract) -> None:
    assert Identifiers(contract, 1).kind_of(0x100) == ("foreign", None)
    layout = contract.layout
    timed = Contract.from_layout(msgspec.structs.replace(layout, sync=msgspec.structs.replace(layout.sync, time_s=2.0)))
    assert Identifiers(timed, 1).kind_of(0x100) == ("TIME", 0)
    assert planned_rates(timed, 1)[0x100, False] == 0.5


@pytest.mark.parametrize("seen", [frames(0), frames(1), frames(5)])
def test_nothing_to_measure_is_said(contract: Contract, planned: BusPlan, seen: Frames) -> None:
    with pytest.raises(InputError, match="expected"):
        whole_cycles(seen)


def made(*ids_and_times: tuple[int, float]) -> Frames:
    """Return frames of 8 bytes, SYNC of one, of identifiers and times in milliseconds."""
    found = frames(len(ids_and_times))
    for place, (can_id, time_ms) in enumerate(ids_and_times):
        found["can_id"][place], found["time_ns"][place] = can_id, round(time_ms * 1e6)
    found["length"] = np.where(found["can_id"] == 0x80, 1, 8)
    return found


def test_cycles_go_from_the_first_sync_until_before_the_last() -> None:
    seen = made((0x181, 1), (0x80, 2), (0x182, 3), (0x80, 12), (0x183, 13), (0x80, 22), (0x184, 23))
    taken, seconds = whole_cycles(seen)
    assert taken["can_id"].tolist() == [0x80, 0x182, 0x80, 0x183]
    assert seconds == pytest.approx(0.02)
    taken, seconds = whole_cycles(seen[:5])
    assert (taken["can_id"].tolist(), seconds) == ([0x80, 0x182], pytest.approx(0.01))
    # With one SYNC or none from the first frame to the last, which is not counted.
    taken, seconds = whole_cycles(seen[:3])
    assert (taken["can_id"].tolist(), seconds) == ([0x181, 0x80], pytest.approx(0.002))
    taken, seconds = whole_cycles(seen[[0, 2]])
    assert (taken["can_id"].tolist(), seconds) == ([0x181], pytest.approx(0.002))
    seen["flags"][[1, 5]] = ERROR
    assert whole_cycles(seen)[0]["can_id"].tolist() == [0x181, 0x182, 0x80, 0x183]


@pytest.mark.parametrize("after_s", [3.0, 3600.0, 1e9])
def test_a_silence_is_no_time_of_a_load(contract: Contract, planned: BusPlan, healthy: Frames, after_s: float) -> None:
    later = healthy[: len(healthy) // 3].copy()
    later["time_ns"] += int(healthy["time_ns"][-1]) + round(after_s * 1e9)
    seen = np.concatenate((healthy, later))
    load = measure(contract, 1, seen, planned)
    assert load.load_exact == measure(contract, 1, healthy, planned).load_exact
    (line,) = misfits(contract, 1, seen, load)
    assert line.startswith("bus1: the loads are those of 2.0 s of ")


def test_a_bus_with_few_frames_is_not_silent() -> None:
    assert len(whole_cycles(made(*((0x181, 3000.0 * place) for place in range(10))))[0]) == 9


def test_loads_are_bits_of_the_bit_rate(contract: Contract, planned: BusPlan) -> None:
    """8 bytes: 111 bits, at most 24 stuff bits; SYNC: 55 bits and a few; in 10 ms of 1 Mbit/s."""
    load = measure(contract, 1, made((0x80, 0), (0x181, 1), (0x181, 2), (0x80, 10)), planned)
    _, node = load.nodes
    assert (node.node_id, node.frames, load.seconds) == (1, 2, pytest.approx(0.01))
    assert node.load_worst == pytest.approx(2 * 135e-6 / 0.01)
    assert 2 * 111e-6 / 0.01 < node.load_exact < node.load_worst
    rates = [(each.cob_id, each.rate_hz, each.planned_rate_hz) for each in load.identifiers]
    assert rates == [(0x80, pytest.approx(100.0), 200.0), (0x181, pytest.approx(200.0), 100.0)]
    assert planned_rates(contract, 1)[0x720, False] == 1.0


@pytest.mark.parametrize(("wrong", "is_said"), [(2, False), (3, True)])
def test_a_fifth_of_wrong_frames_is_no_misfit(contract: Contract, planned: BusPlan, wrong: int, is_said: bool) -> None:
    """Ten frames are measured, of which SYNC is one, and ten TPDOs of which some are too short."""
    unknown = [0x7F0] * wrong + [0x181] * (9 - wrong)
    seen = made((0x80, 0), *((each, 1 + place) for place, each in enumerate(unknown)), (0x80, 100))
    found = misfits(contract, 1, seen, measure(contract, 1, seen, planned))
    assert [line.split("; ")[0] for line in found] == (
        [f"bus1: {wrong} of 10 frames have identifiers that the layout does not plan"] if is_said else []
    )
    seen = made((0x80, 0), *((0x181, 1 + place) for place in range(10)), (0x80, 100))
    seen["length"][1 : 1 + wrong] = 7
    found = misfits(contract, 1, seen, measure(contract, 1, seen, planned))
    assert [line.split("; ")[0] for line in found] == (
        [f"bus1: {wrong} of 10 TPDOs have another length or format than the layout plans"] if is_said else []
    )


def test_each_range_of_identifiers_belongs_to_the_nodes_of_the_bus(contract: Contract) -> None:
    """32 nodes: 0x80 + 33 and the like are foreign, and so are extended and remote frames."""
    kinds = {0x080: "EMCY", 0x180: "TPDO", 0x280: "TPDO", 0x580: "SDO response", 0x700: "heartbeat"}
    expected: dict[int, tuple[str, int | None]] = {0x000: ("NMT", 0), 0x080: ("SYNC", 0), 0x620: ("SDO request", 0)}
    expected |= {base + node: (kind, node) for base, kind in kinds.items() for node in (1, 32)}
    identifiers = Identifiers(contract, 1)
    for cob_id in (*expected, *(base + place for base in (0x180, 0x580, 0x600, 0x700) for place in (0, 33)), 0x800):
        assert identifiers.kind_of(cob_id) == expected.get(cob_id, ("foreign", None))
    other = made(*((0x181, place) for place in range(3)))
    other["flags"] = 0, REMOTE, EXTENDED
    assert identifiers.is_sums(other).tolist() == [True, False, False]
    assert Identifiers(contract, 0).is_right(made((0x181, 0), (0x182, 1), (0x7F0, 2))).tolist() == [True, True, False]


def test_a_message_of_another_device_may_have_the_name_of_a_service() -> None:
    table = {"name": "EMCY", "identifier": 0x0C0, "period_s": 0.01}
    contract = shared_contract(foreign=[table])
    seen = made(*((0x0C0, 10.0 * number) for number in range(50)))
    load = measure(contract, 0, seen, plan(contract)[0])
    assert [(each.kind, each.message) for each in load.identifiers] == [("other device", "EMCY")]
    assert list(foreign(load)) == []
    often = made(*((0x0C0, 5.0 * number) for number in range(50)))
    (line,) = foreign(measure(contract, 0, often, plan(contract)[0]))
    assert line.startswith("'EMCY' of another device comes 200.00 times a second")


def test_an_extended_identifier_is_no_sync(contract: Contract, planned: BusPlan, healthy: Frames) -> None:
    found = left(contract, planned, put(700, 0x80, EXTENDED)(drop(0x80)(healthy)))
    assert "bus1: no SYNC: cycles cannot be told apart" in found
    assert any(line.startswith("bus1: 00000080h is not planned") for line in found)


def test_errors_of_a_log_are_counted_and_are_no_load(contract: Contract, planned: BusPlan) -> None:
    seen = made((0x80, 0), (0x181, 1), (0x182, 2), (0x183, 3), (0x80, 10))
    assert measure(contract, 1, seen, planned).errors == 0
    seen["flags"][1:4] = ERROR, REMOTE, ERROR | EXTENDED
    load = measure(contract, 1, seen, planned)
    assert (load.errors, load.frames, [each.cob_id for each in load.identifiers]) == (2, 2, [0x80, 0x182])
