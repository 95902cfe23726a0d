"""Recorded frames of stepped boards give the sums of the live gateway."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from dbc.contract import Contract
from dbc.frame import Frames, frames
from gateway.playback import play
from tests.gateway.boards import BoardWorld, sums_of


@dataclass
class Recorded(BoardWorld):
    """A world whose frames are kept as the gateway reads them."""

    kept: dict[int, list[Frames]] = field(default_factory=dict)

    def hear(self, bus: int, arrived: Frames) -> None:
        self.kept.setdefault(bus, []).append(arrived.copy())
        super().hear(bus, arrived)

    def logged(self) -> dict[int, Frames]:
        return {bus: np.concatenate([frames(0), *kept]) for bus, kept in self.kept.items()}


@pytest.fixture(scope="module")
def recorded(stepped: Contract) -> Recorded:
    """Return a world in which a board is touched, and another later."""
    world = Recorded(stepped)
    world.touch(1)
    world.until_whole(1.0)
    world.run(0.5)
    world.touch(2, seed=2)
    world.run(0.5)
    return world


def test_a_log_is_measured_every_hundredth_of_a_second_where_there_is_news(recorded: Recorded) -> None:
    parts = list(play(recorded.contract, recorded.logged()))
    made = [each for part in parts for each in part.measurements]
    for block in range(4):
        np.testing.assert_array_equal(sums_of(made[-1], block), sums_of(recorded.measured[-1], block))
    at_ns = np.array([each.sampled_mono_ns for each in made])
    assert (np.diff(at_ns) >= 0).all()
    kept = recorded.logged()
    of_parts = [np.concatenate(list(part.frames.values())) for part in parts if part.frames]
    assert sum(map(len, of_parts)) == sum(map(len, kept.values()))
    assert max(int(np.ptp(each["time_ns"])) for each in of_parts if len(each)) < 100_000_000


def test_sums_that_change_fifty_times_a_second_are_all_measured(stepped: Contract) -> None:
    world = Recorded(stepped)
    world.until_whole(1.0)
    first_ns = round(world.now_s * 1e9)
    for size_n in range(1, 11):
        world.touch(1, size_n=0.1 * size_n)
        world.run(0.02)
    made = [each for part in play(stepped, world.logged()) for each in part.measurements]
    shown = {sums_of(each, 1).tobytes() for each in made if each.sampled_mono_ns > first_ns}
    assert len(shown) >= 10
    assert len(made) <= 10 + 100 * 0.3


def test_a_clock_that_is_set_forward_by_years_ends_in_no_loop_of_years(recorded: Recorded) -> None:
    late = recorded.logged()
    for seen in late.values():
        seen["time_ns"][len(seen) // 2 :] += 10**18
    made = [each for part in play(recorded.contract, late) for each in part.measurements]
    at_ns = np.array([each.sampled_mono_ns for each in made])
    assert (np.diff(at_ns) >= 0).all()
    assert at_ns[-1] > 10**18
