"""Recorded frames give the measurements of the live gateway, however they are cut into parts."""

import numpy as np
import pytest

from canskin.messages import UNKNOWN_ERROR_NS, Measurement
from dbc.contract import Contract
from dbc.frame import ECHO, ERROR, EXTENDED, FD, REMOTE, Frames
from gateway.playback import Playback, play, with_echoes
from tests.bus.harness import frame
from tests.recording.conftest import bus_frames, contract, force_n, sums
from tests.recording.helpers import OFFSET_NS

__all__ = ["bus_frames", "contract", "force_n", "sums"]


def whole(contract: Contract, logged: dict[int, Frames]) -> list[Measurement]:
    return [each for part in play(contract, logged) for each in part.measurements]


def test_measurements_are_the_sums_of_the_nodes(
    contract: Contract, sums: np.ndarray, bus_frames: dict[int, Frames]
) -> None:
    first_ns = int(bus_frames[0]["time_ns"][0])
    playback = Playback(contract, bus_frames.keys(), first_ns, OFFSET_NS)
    for bus, seen in bus_frames.items():
        playback.feed(bus, seen)
    made = playback.finish()
    assert [each.cycle for each in made] == list(range(1, len(sums) + 1))
    assert all(each.valid == b"\1" * 16 for each in made)
    np.testing.assert_array_equal([np.frombuffer(each.sums, "<i4") for each in made], sums)
    ends_ns = [int(seen["time_ns"][0]) for seen in bus_frames.values()]
    assert np.frombuffer(made[0].bus_sampled_ns, "<i8").tolist() == ends_ns
    assert made[0].sampled_mono_ns == pytest.approx(np.mean(ends_ns), abs=1)
    assert made[0].time_ns == made[0].sampled_mono_ns + OFFSET_NS
    assert made[0].sampled_error_ns == UNKNOWN_ERROR_NS  # frames do not tell when the SYNC was sent
    status = playback.status()
    assert status.cycles_complete == len(sums)
    assert status.buses[0].mean_load_ratio > 0


def test_parts_of_any_length_give_the_same(contract: Contract, bus_frames: dict[int, Frames]) -> None:
    expected = whole(contract, bus_frames)
    first_ns, last_ns = (int(bus_frames[0]["time_ns"][place]) for place in (0, -1))
    playback, made, used = Playback(contract, bus_frames.keys(), first_ns), [], dict.fromkeys(bus_frames, 0)
    for until_ns in range(first_ns, last_ns, 1_300_000):
        for bus, seen in bus_frames.items():
            # More than what is asked for may have come already.
            end = int(np.searchsorted(seen["time_ns"], until_ns + 400_000 * bus, "right"))
            playback.feed(bus, seen[used[bus] : end])
            used[bus] = end
        made += playback.advance(until_ns)
    for bus, seen in bus_frames.items():
        playback.feed(bus, seen[used[bus] :])
    made += playback.finish()
    assert made == expected


def test_a_bus_that_was_not_recorded_is_not_valid(contract: Contract, bus_frames: dict[int, Frames]) -> None:
    made = whole(contract, {1: bus_frames[1]})
    assert all(each.valid == b"\0" * 8 + b"\1" * 8 for each in made)
    assert len(made) == len(whole(contract, bus_frames))


def test_lost_frames_cost_their_block_alone(contract: Contract, bus_frames: dict[int, Frames]) -> None:
    seen = bus_frames[0]
    places = np.flatnonzero(seen["can_id"] != 0x80)[[3, 40]]
    logged = {0: np.delete(seen, places), 1: bus_frames[1]}
    lost = [each.valid.count(b"\0") for each in whole(contract, logged)]
    assert sum(lost) == 2
    assert max(lost) == 1


@pytest.mark.parametrize(("later_ns", "cycles_more"), [(20_000, 0), (4_000_000, 0), (6_000_000, 1)])
def test_a_sync_comes_again(contract: Contract, bus_frames: dict[int, Frames], later_ns: int, cycles_more: int) -> None:
    """Within half a period: its cycle is not valid. Later: another cycle begins."""
    expected = whole(contract, bus_frames)
    logged = {}
    for bus, seen in bus_frames.items():
        place = int(np.flatnonzero(seen["can_id"] == 0x80)[4])
        again = seen[place : place + 1].copy()
        again["time_ns"] += later_ns
        # The cycle has lost a frame: it is open when its SYNC comes again.
        less = np.delete(seen, place + 1)
        logged[bus] = np.insert(less, int(np.searchsorted(less["time_ns"], again["time_ns"][0])), again)
    made = whole(contract, logged)
    assert len(made) == len(expected) + cycles_more
    assert made[:4] == expected[:4]
    if not cycles_more:
        assert not any(made[4].valid)
    found, known = ([(each.sums, each.valid) for each in part] for part in (made[7 + cycles_more :], expected[7:]))
    assert found == known


def test_a_cycle_ends_when_no_sync_follows(contract: Contract, bus_frames: dict[int, Frames]) -> None:
    """A frame that is missing in it and comes two periods later is not used."""
    logged, expected = {}, whole(contract, bus_frames)
    for bus, seen in bus_frames.items():
        syncs = np.flatnonzero(seen["can_id"] == 0x80)
        gone = list(range(syncs[4], syncs[5] + 1))
        logged[bus] = np.delete(seen, [*gone, int(syncs[3]) + 1] if bus == 0 else gone)
    made = whole(contract, logged)
    assert len(made) == len(expected) - 2
    assert made[3].valid.count(b"\0") == 1
    assert made[2] == expected[2]


@pytest.mark.parametrize(
    ("data", "flags", "is_echo"),
    [
        (b"\1", 0, True),
        (b"\xf0", 0, True),
        (b"\0", 0, False),
        (b"\xf1", 0, False),
        (b"", 0, False),
        (b"\1\1", 0, False),
        *((b"\1", flags, False) for flags in (EXTENDED, REMOTE, ERROR, FD)),
    ],
)
def test_syncs_of_the_gateway_are_told_by_their_form(data: bytes, flags: int, *, is_echo: bool) -> None:
    """CiA 301: the counter is 1 to 240."""
    logged = np.concatenate([frame(0x80, data, flags), frame(0x81, data, flags)])
    marked = with_echoes(logged)
    assert (marked["flags"] & ECHO != 0).tolist() == [is_echo, False]
    assert (logged["flags"] == flags).all()


def test_the_last_cycle_is_measured_also_when_a_frame_is_missing(
    contract: Contract, bus_frames: dict[int, Frames]
) -> None:
    expected = whole(contract, bus_frames)
    playback = Playback(contract, bus_frames.keys(), int(bus_frames[0]["time_ns"][0]))
    for bus, seen in bus_frames.items():
        playback.feed(bus, seen[:-1] if bus == 0 else seen)
    made = playback.finish()
    assert len(made) == len(expected)
    assert [each.sums for each in made[:-1]] == [each.sums for each in expected[:-1]]
    assert made[-1].valid.count(b"\0") == 1


@pytest.mark.parametrize("fall_s", [0.05, 0.5, 1e6])
def test_times_of_measurements_never_fall(contract: Contract, bus_frames: dict[int, Frames], fall_s: float) -> None:
    logged = {bus: seen.copy() for bus, seen in bus_frames.items()}
    for seen in logged.values():
        seen["time_ns"][len(seen) // 2 :] -= round(fall_s * 1e9)
    at_ns = np.array([each.sampled_mono_ns for part in play(contract, logged) for each in part.measurements])
    assert len(at_ns) > 1
    assert (np.diff(at_ns) >= 0).all()
