"""When adaptive sums are measured, and of which frames."""

import numpy as np
import pytest

from canskin.errors import InputError
from dbc.contract import Contract
from gateway.adaptive_gathering import AdaptiveGathering, publishing_rates
from gateway.gathering import Health
from tests.bus.harness import frame
from tests.gateway.boards import BoardWorld


@pytest.mark.parametrize(
    ("asked", "rates"),
    [
        ((None, None), (1000.0, 10.0)),
        ((5.0, None), (5.0, 5.0)),
        ((1.0, 1.0), (1.0, 1.0)),
        ((1000.0, 1000.0), (1000.0, 1000.0)),
        ((0.999, None), None),
        ((1000.1, None), None),
        ((None, 0.999), None),
        ((20.0, 20.1), None),
    ],
)
def test_rates_are_one_to_a_thousand_hertz(
    asked: tuple[float | None, float | None], rates: tuple[float, float] | None
) -> None:
    if rates is None:
        with pytest.raises(InputError):
            publishing_rates(*asked)
    else:
        assert publishing_rates(*asked) == rates


def test_a_doubt_is_measured_after_a_millisecond_and_nothing_new_after_a_tenth_of_a_second(adaptive: Contract) -> None:
    gathering = AdaptiveGathering(adaptive, {}, 50.0)
    assert gathering.in_flight == 0
    assert gathering.due_s == pytest.approx(50.1)
    assert gathering.may_sleep_until_s == pytest.approx(50.001)
    world = BoardWorld(adaptive)
    world.until_whole(1.0)
    mine = world.gateway.gathering
    mine.measurements(world.now_s + 1.0, 0)
    assert mine.due_s == pytest.approx(world.now_s + 1.1)
    mine.trust(adaptive.nodes[1], proven=False)
    assert mine.due_s == pytest.approx(world.now_s + 1.001)
    (made,) = mine.measurements(mine.due_s, 0)
    assert (made.valid, made.known[32:64]) == (b"\1\0\1\1", bytes(32))


def test_the_newest_frame_of_each_bus_is_told(boards: BoardWorld) -> None:
    first = boards.measured[0]
    assert np.frombuffer(first.bus_sampled_ns, "<i8").tolist() == [0, 0]
    boards.run(0.2)
    before = np.frombuffer(boards.measured[-1].bus_sampled_ns, "<i8")
    boards.touch(1, seed=5)
    boards.run(0.2)
    ended_ns = np.frombuffer(boards.measured[-1].bus_sampled_ns, "<i8")
    assert ended_ns[0] > before[0]
    assert ended_ns[1] == before[1]
    assert boards.measured[-1].sampled_mono_ns == ended_ns.max()


def test_no_frame_is_due(adaptive: Contract) -> None:
    gathering = AdaptiveGathering(adaptive, {}, 50.0)
    assert gathering.missing_and_late(0) == (0, 0)


def test_frames_of_nobody_are_foreign(boards: BoardWorld) -> None:
    before = boards.gateway.gathering.counts.foreign
    strange = np.concatenate([frame(0x080, b"\1"), frame(0x7FF, b"\1")])
    boards.gateway.gathering.take(0, strange, Health(), boards.now_s)
    assert boards.gateway.gathering.counts.foreign == before + 2
    assert boards.gateway.gathering.take_foreign_syncs(0) == 1
    assert boards.gateway.gathering.take_foreign_syncs(0) == 0
