"""Recorded frames of stepped boards give the sums of the live gateway."""

from dataclasses import dataclass, field

import msgspec
import numpy as np
import pytest

from canskin.messages import Measurement
from dbc.contract import Contract
from dbc.frame import Frames, frames
from gateway.playback import SteppedPlayback, play
from tests.gateway.boards import BoardWorld, known_of, sums_of


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


def newest(measurement: Measurement, earlier_ns: int) -> Measurement:
    """Return a measurement whose newest frames are said to have ended earlier."""
    ended_ns = np.frombuffer(measurement.bus_sampled_ns, "<i8") - earlier_ns
    return msgspec.structs.replace(measurement, bus_sampled_ns=ended_ns.tobytes())


def playback_of(recorded: Recorded, since_ns: int = 0) -> SteppedPlayback:
    logged = recorded.logged()
    playback = SteppedPlayback(recorded.contract, logged.keys())
    for bus, seen in logged.items():
        half = len(seen) // 2
        for part in (seen[:half], seen[half:]):
            playback.feed(bus, part[part["time_ns"] >= since_ns])
    return playback


def test_every_measurement_has_the_sums_of_its_frames(recorded: Recorded) -> None:
    playback = playback_of(recorded)
    assert [playback.measured(each) for each in recorded.measured] == recorded.measured
    assert playback.held == 0
    assert sums_of(recorded.measured[-1], 2).any()


def test_the_frames_count_and_not_the_recorded_sums(recorded: Recorded) -> None:
    playback, last = playback_of(recorded), recorded.measured[-1]
    for each in recorded.measured[:-1]:
        playback.measured(each)
    changed = msgspec.structs.replace(last, sums=(np.frombuffer(last.sums, "<i4") + 7).astype("<i4").tobytes())
    assert playback.measured(changed).sums == last.sums
    unknown = bytearray(last.known)
    unknown[32:40] = bytes(8)
    less = sums_of(playback.measured(msgspec.structs.replace(last, known=bytes(unknown))), 1)
    assert not less[:8].any()
    np.testing.assert_array_equal(less[8:], sums_of(last, 1)[8:])


def test_a_sum_without_frames_is_the_recorded_one(recorded: Recorded) -> None:
    """The recording begins when the second touch does: boards that are still send nothing more of the first."""
    late = [each for each in recorded.measured if known_of(each, 1).all()][-60:]
    first_ns = int(np.frombuffer(late[0].bus_sampled_ns, "<i8").max())
    playback = playback_of(recorded, first_ns + 1)
    assert playback.measured(late[0]).sums == late[0].sums
    assert playback.held == 128
    for each in late[1:]:
        assert playback.measured(each).sums == each.sums


@pytest.mark.parametrize(("earlier_ns", "is_held"), [(0, False), (5_000, False), (5_001, True)])
def test_time_stamps_of_gateway_and_recorder_differ_by_five_microseconds(
    recorded: Recorded, earlier_ns: int, *, is_held: bool
) -> None:
    first = next(each for each in recorded.measured if sums_of(each, 1).any())
    playback = playback_of(recorded)
    assert playback.measured(newest(first, earlier_ns)).sums == first.sums
    assert (playback.held > 0) == is_held


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
