"""Which recorded SYNCs are one cycle, when a cycle ends in recorded time, and how a log is cut into parts."""

import numpy as np
import pytest

from dbc.contract import Contract
from dbc.frame import Frames, frames
from gateway.cycles import RATE_SYNCS
from gateway.playback import Playback, play
from tests.bus.harness import frame

START_NS = 1_000_000_000_000
MS = 1_000_000


def sync(at_ms: float, counter: int | None = None) -> Frames:
    """Return a SYNC; without `counter`, that of its time at 20 Hz."""
    known = 1 + round(at_ms // 50) % 240 if counter is None else counter
    return frame(0x80, bytes((known,)), time_ns=START_NS + round(at_ms * MS))


def answers(contract: Contract, bus: int, at_ms: float, counter: int | None = None) -> Frames:
    """Return the frames of all nodes of a bus in the cycle of a SYNC; without `counter`, that of their time."""
    table = contract.table
    rows = np.flatnonzero(table.bus == bus)
    burst = frames(len(rows))
    burst["can_id"], burst["length"] = table.cob_id[rows], table.length[rows]
    burst["data"][:, 0] = 1 + round(at_ms // 50) % 240 if counter is None else counter
    burst["time_ns"] = START_NS + round(at_ms * MS)
    return burst


def playback_of(contract: Contract, *logged: list[Frames]) -> Playback:
    playback = Playback(contract, range(len(logged)), START_NS)
    for bus, parts in enumerate(logged):
        playback.feed(bus, np.concatenate([frames(0), *parts]))
    return playback


def test_a_sync_of_one_bus_may_come_after_the_next_of_another_and_not_later(small: Contract) -> None:
    first = [sync(0, 1), sync(50, 2), sync(100, 3)]
    playback = playback_of(small, first, [sync(60, 1), sync(70, 2), sync(110, 3)])
    assert [each.sync_counter for each in playback.finish()] == [1, 2, 3]
    assert playback.cycles == 3
    playback = playback_of(small, first, [sync(110, 1), sync(120, 2), sync(130, 3)])
    playback.finish()
    assert playback.cycles == 6


def test_a_sync_twice_on_a_bus_is_one_within_half_a_period(small: Contract) -> None:
    for again_ms, cycles in ((24.9, 1), (25.0, 2)):
        playback = playback_of(small, [sync(0, 7), sync(again_ms, 7)], [])
        playback.finish()
        assert playback.cycles == cycles


def test_each_bus_has_a_sync_once_in_a_cycle(small: Contract) -> None:
    playback = playback_of(small, [sync(0, 7)], [sync(1, 7), sync(30, 7)])
    playback.finish()
    assert playback.cycles == 2


@pytest.mark.parametrize("start_s", [1_000, 1_037, 4_071, 1_700_000_000, 1_700_000_111])
def test_the_last_cycle_of_a_log_is_made_on_any_clock(small: Contract, start_s: int) -> None:
    playback = Playback(small, [0], start_s * 1000 * MS)
    playback.feed(0, frame(0x80, b"\1", time_ns=start_s * 1000 * MS))
    assert len(playback.finish()) == 1


def test_the_newest_emergency_of_a_log_is_told(small: Contract) -> None:
    told = [frame(0x81, bytes.fromhex("3081110000000000"), time_ns=START_NS + place * MS) for place in range(5)]
    playback = playback_of(small, told)
    playback.finish()
    assert playback.status().buses[0].emcy == [0x8130, 0]


def test_counters_go_round(small: Contract) -> None:
    playback = playback_of(small, [sync(50 * place) for place in range(243)], [])
    made = playback.finish()
    assert [each.sync_counter for each in made] == [*range(1, 241), 1, 2, 3]
    assert [each.cycle for each in made] == list(range(1, 244))


def test_a_cycle_ends_with_its_last_frame_or_nine_tenths_of_a_period_after_the_next_sync(small: Contract) -> None:
    whole = [[sync(0), answers(small, bus, 3)] for bus in (0, 1)]
    playback = playback_of(small, *whole)
    assert playback.advance(START_NS + 3 * MS - 1) == []
    (made,) = playback.advance(START_NS + 3 * MS)
    assert made.valid == b"\1" * 4
    assert made.wall_offset_ns == 0
    playback = playback_of(small, whole[0], [sync(0)])
    assert playback.advance(START_NS + 95 * MS - 1000) == []
    (made,) = playback.advance(START_NS + 95 * MS + 1000)
    assert made.valid == b"\1\1\0\0"
    assert playback.finish() == []


def test_a_frame_that_comes_when_its_cycle_is_over_is_late(small: Contract) -> None:
    """The next SYNC, three periods later, does not keep it open."""
    late = [sync(0), answers(small, 1, 96, 1), sync(150), answers(small, 1, 151)]
    playback = playback_of(small, [sync(0), answers(small, 0, 1), sync(150), answers(small, 0, 151)], late)
    made = playback.finish()
    assert [each.valid[:2] for each in made] == [b"\1\1", b"\1\1"]
    assert made[0].valid[2:] == b"\0\0"
    assert playback.status().frames.late == 4


def test_frames_count_from_the_newest_time_before_them_on(small: Contract) -> None:
    """Time stamps of a log may go back; the order of the bus is that of the log."""
    early = answers(small, 1, 1)
    playback = playback_of(
        small, [sync(2), answers(small, 0, 3)], [sync(2), frame(0x555, time_ns=START_NS + 9 * MS), early]
    )
    assert playback.advance(START_NS + 8 * MS) == []
    (made,) = playback.advance(START_NS + 9 * MS)
    assert made.valid == b"\1" * 4


def test_status_counts_the_recorded_frames_alone(small: Contract) -> None:
    playback = playback_of(small, *([sync(0), answers(small, bus, 3), frame(0x555)] for bus in (0, 1)))
    playback.finish()
    status = playback.status()
    assert (status.frames.accepted, status.frames.foreign, status.frames.missing, status.cycles) == (8, 2, 0, 1)
    assert status.time_ns == pytest.approx(START_NS + 98 * MS, abs=2000)
    assert status.buses[0].overrun == 0
    assert status.buses[0].link == "active"


def test_the_rate_counts_from_the_first_sync(small: Contract) -> None:
    playback = playback_of(small, [sync(100 + 50 * number) for number in range(RATE_SYNCS)], [])
    playback.advance(START_NS + 50 * MS)
    assert playback.status().sync_rate_hz == 0.0
    playback.advance(START_NS + 100 * MS)
    assert playback.status().sync_rate_hz == 0.0
    playback.advance(START_NS + 1000 * MS)
    assert playback.status().sync_rate_hz == 0.0  # one is still to come
    playback.advance(START_NS + 1100 * MS)
    assert playback.status().sync_rate_hz == pytest.approx(RATE_SYNCS)


def test_a_node_that_boots_is_not_valid_until_it_is_started(small: Contract) -> None:
    boot, start = (
        frame(can_id, data, time_ns=START_NS + at_ms * MS)
        for can_id, data, at_ms in ((0x701, b"\0", 10), (0x000, b"\1\1", 60))
    )
    cycles = [part for at_ms in (0, 50, 100) for part in (sync(at_ms), answers(small, 0, at_ms + 3))]
    first = [*cycles[:2], boot, *cycles[2:4], start, *cycles[4:]]
    second = [part for at_ms in (0, 50, 100) for part in (sync(at_ms), answers(small, 1, at_ms + 3))]
    made = playback_of(small, first, second).finish()
    assert [each.valid for each in made] == [b"\1\1\1\1", b"\0\1\1\1", b"\1\1\1\1"]


# Parts


def test_a_log_is_cut_where_tenths_of_a_second_begin(small: Contract) -> None:
    times_ns = [START_NS, START_NS + 100 * MS - 1, START_NS + 100 * MS, START_NS + 350 * MS]
    logged = {
        0: np.concatenate([frame(0x555, time_ns=time_ns) for time_ns in times_ns]),
        1: np.concatenate([frame(0x80, b"\1", time_ns=START_NS + 450 * MS)]),
    }
    parts = list(play(small, logged))
    lengths = [[len(part.frames[bus]) for bus in (0, 1)] for part in parts[:-1]]
    assert lengths == [[2, 0], [1, 0], [1, 0], [0, 1]]
    assert parts[-1].frames == {}
    assert [len(part.measurements) for part in parts] == [0, 0, 0, 0, 1]
    assert [part.status.frames.foreign for part in parts] == [2, 3, 4, 4, 4]
    ends_ms = [(part.status.time_ns - START_NS) / MS for part in parts[:-1]]
    assert ends_ms == pytest.approx([100, 200, 400, 500])
    assert parts[-1].measurements[0].cycle == 1
