"""Until when a gateway of synchronous sums may leave frames unread."""

import pytest

from dbc.configuration import READ_S
from dbc.contract import Contract
from dbc.frame import frames
from gateway.batch import batch_of
from gateway.cycle_gathering import CycleGathering
from gateway.gathering import Health, Sync

#: Bits of a classic frame of eight bytes without stuff bits, intermission included.
FRAME_BITS = 111
NEVER_S = float("-inf")


def begun(contract: Contract, *, stamp_error_ns: int | None = 0) -> CycleGathering:
    """Return a gathering of proven nodes whose first cycle began at 1 s."""
    gathering, health = CycleGathering(contract), Health()
    health.stamp_error_ns = stamp_error_ns
    for node in contract.nodes:
        gathering.trust(node, proven=True)
    for bus in range(len(contract.layout.bus)):
        gathering.take(batch_of(frames(0), bus, contract.table), health, 0.5)
    gathering.begin(Sync(1, 1, 1_000_000_000, 1_000_000_000, 0))
    return gathering


def test_frames_may_wait_as_long_as_the_bus_needs_for_them(small: Contract) -> None:
    frames_of_bus = len(small.cycle(0)) - 1
    expected_s = 1.0 + frames_of_bus * FRAME_BITS / small.layout.bus[0].bitrate
    assert begun(small).may_sleep_until_s == pytest.approx(expected_s, abs=1e-9)


def test_answers_of_a_node_that_is_not_proven_do_not_wait(small: Contract) -> None:
    gathering = begun(small)
    gathering.trust(small.nodes[1], proven=False)
    assert gathering.may_sleep_until_s == NEVER_S


def test_frames_without_stamps_do_not_wait(small: Contract) -> None:
    assert begun(small, stamp_error_ns=None).may_sleep_until_s == NEVER_S


def test_between_cycles_frames_wait_a_little(small: Contract) -> None:
    gathering = begun(small)
    gathering.measurements(10.0, 0)
    assert gathering.may_sleep_until_s == 10.0 + READ_S


def waits_s(gathering: CycleGathering, cycles: int, *, looks: int) -> list[float]:
    """Return how long frames wait in each of some cycles, a second apart, that are not whole at some looks."""
    found_s = []
    for number in range(2, cycles + 2):
        gathering.measurements(number - 0.1, 0)  # ends the cycle before
        gathering.begin(Sync(number, number, number * 1_000_000_000, number * 1_000_000_000, 0))
        found_s.append(gathering.may_sleep_until_s - number)
        for look in range(looks):
            gathering.measurements(number + (gathering.due_s - number) * (0.5 + 0.1 * look), 0)
    return found_s


def test_frames_wait_for_the_stuff_bits_that_cycles_have(small: Contract) -> None:
    gathering = begun(small)
    frames_of_bus = len(small.cycle(0)) - 1
    longer_s = waits_s(gathering, 60, looks=3)
    assert longer_s[-1] == pytest.approx(frames_of_bus * small.longest_ns(0) * 1e-9, rel=0.01)
    assert longer_s == pytest.approx(sorted(longer_s), abs=1e-9)
    shorter_s = waits_s(gathering, 120, looks=0)
    assert shorter_s[-1] == pytest.approx(frames_of_bus * FRAME_BITS / small.layout.bus[0].bitrate, abs=1e-9)
