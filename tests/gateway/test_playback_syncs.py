"""Which recorded SYNCs are one cycle, when a cycle ends in recorded time, and how a log is cut into parts."""

import numpy as np
import pytest

from dbc.contract import Contract
from dbc.frame import Frames, frames
from gateway.playback import Playback, play
from gateway.sync_clock import RATE_SYNCS
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


def cycle(small: Contract, bus: int, at_ms: float, *answer_ms: float) -> list[Frames]:
    """Return a SYNC, and all answers to it, at some times."""
    return [sync(at_ms), *(answers(small, bus, each, 1 + round(at_ms // 50)) for each in answer_ms)]


def test_which_syncs_are_one_cycle(small: Contract) -> None:
    first = [sync(0, 1), sync(50, 2), sync(100, 3)]
    for logged, cycles in (
        ((first, [sync(60, 1), sync(70, 2), sync(110, 3)]), 3),  # after the next SYNC of the other bus
        ((first, [sync(110, 1), sync(120, 2), sync(130, 3)]), 6),  # later
        (([sync(0, 7), sync(24.9, 7)], []), 1),  # again within half a period
        (([sync(0, 7), sync(25.0, 7)], []), 2),
        (([sync(0, 7)], [sync(1, 7), sync(30, 7)]), 2),  # each bus has a SYNC once in a cycle
    ):
        playback = playback_of(small, *logged)
        made = playback.finish()
        assert playback.cycles == len(made) == cycles
    assert [each.sync_counter for each in playback_of(small, first, []).finish()] == [1, 2, 3]


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


@pytest.mark.parametrize(
    ("extra", "valid", "late"),
    [
        ([], ["1111", "1111", "1111"], 0),
        # The next SYNC, three periods later, does not keep a cycle open.
        ([(1, "answers", 96)], ["1100", "1111", "1111"], 4),
        ([(1, "again", 3)], ["1111", "1111", "1111"], 0),
        ([(0, "other", 3)], ["0011", "1111", "1111"], 0),
        ([(0, "boot", 10)], ["1111", "0111", "0111"], 0),
        ([(0, "boot", 10), (0, "start", 160)], ["1111", "0111", "1111"], 0),
    ],
)
def test_blocks_are_valid_as_live(
    small: Contract, extra: list[tuple[int, str, int]], valid: list[str], late: int
) -> None:
    """Of three cycles, with frames that come besides, or in place of the answers of the first cycle."""
    logged: list[list[Frames]] = []
    for bus in (0, 1):
        mine = [*cycle(small, bus, 0, 3), *cycle(small, bus, 150, 153), *cycle(small, bus, 200, 203)]
        for at, what, at_ms in extra:
            if at != bus:
                continue
            if what == "answers":
                mine[1] = answers(small, bus, at_ms, 1)
                continue
            came = answers(small, bus, at_ms, 1)
            came["data"][:, 1] ^= what == "other"
            more = {
                "boot": frame(0x701, b"\0", time_ns=START_NS + at_ms * MS),
                "start": frame(0x000, b"\1\1", time_ns=START_NS + at_ms * MS),
            }
            mine.append(more.get(what, came))
        whole = np.concatenate(mine)
        logged.append([whole[np.argsort(whole["time_ns"], kind="stable")]])
    playback = playback_of(small, *logged)
    made = playback.finish()
    assert ["".join(map(str, each.valid)) for each in made] == valid
    assert playback.status().frames.late == late


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
