"""Recorded frames give the measurements of the live gateway, however they are cut into parts."""

import numpy as np
import pytest

from canskin.messages import UNKNOWN_ERROR_NS, Measurement
from dbc.contract import Contract
from dbc.frame import Frames
from gateway.playback import Playback, play
from tests.recording.conftest import OFFSET_NS, bus_frames, contract, force_n, sums

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
    assert status.sync_rate_hz == pytest.approx(100, rel=0.15)
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
    """Within half a period: its cycle and the next are not valid. Later: another cycle begins."""
    assert contract.sync_overflow
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
        assert not any(made[4].valid + made[5].valid)
    found, known = ([(each.sums, each.valid) for each in part] for part in (made[7 + cycles_more :], expected[7:]))
    assert found == known
