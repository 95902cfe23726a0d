"""Arbitration and timing of the bus model, on a bus where nothing goes wrong."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bus.arbitration import clash_bits
from bus.outbox import DISCARDED, OTHERS, OWNER
from bus.simulated_bus import SimulatedBus
from dbc.frame import BRS, EXTENDED, FD, FRAME, REMOTE, Frames
from dbc.frame_bits import INTERMISSION_BITS, frame_time_ns
from tests.bus.harness import burst, frame

INTERMISSION_NS = INTERMISSION_BITS * 1000


def pair(**options: object) -> tuple[SimulatedBus, list[object]]:
    bus = SimulatedBus(**options)  # type: ignore[arg-type]
    return bus, [bus.attach("one"), bus.attach("two")]


def test_a_burst_takes_exactly_the_sum_of_its_bits() -> None:
    bus, (one, _) = pair()
    sent = burst(range(0x1C0, 0x180, -1))
    assert bus.submit(one, sent, 5_000) == 64
    events = bus.run_until()
    assert list(events.frames["can_id"]) == list(range(0x181, 0x1C1))
    assert events.frames["time_ns"][-1] == 5_000 + frame_time_ns(sent, 1_000_000).sum() - INTERMISSION_NS
    assert (events.audience == OTHERS | OWNER).all()
    lasted = frame_time_ns(events.frames, 1_000_000)
    assert (np.diff(events.frames["time_ns"]) == lasted[1:]).all()


def test_lowest_identifier_wins_whoever_sends_it() -> None:
    bus, (one, two) = pair()
    bus.submit(one, burst([0x300, 0x100]), 1)
    bus.submit(two, burst([0x200, 0x080]), 1)
    assert list(bus.run_until().frames["can_id"]) == [0x080, 0x100, 0x200, 0x300]


def test_a_frame_on_the_wire_is_not_interrupted() -> None:
    bus, (one, two) = pair()
    bus.submit(one, burst([0x700, 0x701]), 1)
    bus.run_until(50_000)
    bus.submit(two, burst([0x001]), 50_000)
    assert list(bus.run_until().frames["can_id"]) == [0x700, 0x001, 0x701]


def test_arbitration_reads_the_bits_of_the_wire() -> None:
    base = 0x155
    contenders = [
        frame(base),
        frame(base, flags=REMOTE),
        frame(base << 18, flags=EXTENDED),
        frame(base << 18, flags=EXTENDED | REMOTE),
        frame(base << 18 | 1, flags=EXTENDED),
        frame(base + 1),
    ]
    bus, (one, _) = pair()
    bus.submit(one, np.concatenate(contenders[::-1]), 1)
    sent = bus.run_until().frames
    assert [(int(f["can_id"]), int(f["flags"])) for f in sent] == [
        (int(f["can_id"][0]), int(f["flags"][0])) for f in contenders
    ]


def test_equal_identifiers_of_one_controller_keep_their_order() -> None:
    bus, (one, _) = pair()
    same = burst([0x181] * 20)
    bus.submit(one, same, 1)
    assert (bus.run_until().frames["data"] == same["data"]).all()


def test_a_release_time_in_the_future_is_kept() -> None:
    bus, (one, _) = pair()
    bus.submit(one, np.concatenate([frame(0x080, b"\x01", time_ns=10_000_000), frame(0x700)]), 1)
    early = bus.run_until(9_999_999)
    assert list(early.frames["can_id"]) == [0x700]
    late = bus.run_until()
    ends = 10_000_000 + frame_time_ns(frame(0x080, b"\x01"), 1_000_000)[0] - INTERMISSION_NS
    assert late.frames["time_ns"].tolist() == [ends]


def test_a_sender_that_the_host_let_run_late_is_punctual_on_an_idle_wire() -> None:
    bus, (one, _) = pair()
    bus.run_until(2_000_000)
    late = frame(0x080, b"\x01", time_ns=1_000_000)
    bus.submit(one, late, 2_000_000)
    ends = 1_000_000 + frame_time_ns(late, 1_000_000)[0] - INTERMISSION_NS
    assert bus.run_until().frames["time_ns"].tolist() == [ends]


def test_a_frame_that_cannot_start_in_time_is_given_back() -> None:
    bus, (one, _) = pair()
    sent = burst([0x100, 0x200, 0x300])
    lasts = frame_time_ns(sent, 1_000_000)
    sent["expires_ns"] = [0, lasts[0], lasts[0] + lasts[1] - 1]
    bus.submit(one, sent, 0)
    events = bus.run_until()
    given_back = events.frames["flags"] == DISCARDED
    assert events.frames["can_id"][given_back].tolist() == [0x300]
    assert events.frames["can_id"][~given_back].tolist() == [0x100, 0x200]
    assert (bus.counts.transmitted, bus.counts.discarded, bus.waiting(one)) == (2, 1, 0)


def test_an_expired_frame_is_given_back_while_more_urgent_frames_keep_the_bus() -> None:
    bus, (one, _) = pair()
    waits = burst([0x300])
    waits["expires_ns"] = 500_000
    bus.submit(one, waits, 0)
    bus.submit(one, burst([0x100] * 40), 0)
    events = bus.run_until(1_000_000)
    assert events.frames["can_id"][events.frames["flags"] == DISCARDED].tolist() == [0x300]
    assert bus.idle_from_ns > 40 * 40_000
    assert (bus.run_until().frames["can_id"] == 0x100).all()
    assert (bus.counts.transmitted, bus.counts.discarded, bus.waiting(one)) == (40, 1, 0)


def test_nothing_is_told_before_its_end_of_frame() -> None:
    bus, (one, _) = pair()
    bus.submit(one, burst([0x181]), 1)
    ends = bus.next_event_ns()
    assert ends == 1
    assert len(bus.run_until(1).frames) == 0
    ends = bus.next_event_ns()
    assert ends is not None
    assert len(bus.run_until(ends - 1).frames) == 0
    assert len(bus.run_until(ends).frames) == 1
    assert bus.next_event_ns() is None


def test_fd_frames_use_both_rates() -> None:
    bus, (one, _) = pair(data_bitrate=5_000_000)
    sent = burst([0x181], 64)
    sent["flags"] = FD | BRS
    bus.submit(one, sent, 0)
    lasted = frame_time_ns(sent, 1_000_000, 5_000_000)[0]
    assert bus.run_until().frames["time_ns"][0] == lasted - INTERMISSION_NS
    assert lasted < 170_000


def test_each_controller_has_a_queue_of_its_own() -> None:
    bus = SimulatedBus()
    station = bus.attach("nodes", queue_size=2)
    bus.attach("other")
    sent = np.concatenate([frame(0x100 + n, port=n // 3) for n in range(6)])
    assert bus.submit(station, sent[:3]) == 2
    assert bus.submit(station, sent[3:]) == 2
    bus.run_until()
    assert bus.submit(station, sent) == 2  # the third one finds port 0's queue full again


def test_a_detached_station_leaves_no_frames_behind() -> None:
    bus, (one, two) = pair()
    bus.attach("three")
    bus.submit(one, burst([0x181, 0x182]), 1)
    bus.submit(two, burst([0x183]), 1)
    bus.detach(one)
    assert list(bus.run_until().frames["can_id"]) == [0x183]
    assert bus.counts.discarded == 2


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 1), st.integers(0, 0x7FF), st.integers(0, 3_000_000)), max_size=40), st.data())
def test_however_time_is_cut_the_same_happens(plan: list[tuple[int, int, int]], draw: st.DataObject) -> None:
    """No frame is lost or made up, no two overlap, and asking in small steps changes nothing."""
    unique = {can_id: (who, at) for who, can_id, at in plan}

    def run(cuts: list[int]) -> Frames:
        bus, stations = pair()
        for can_id, (who, at) in unique.items():
            bus.submit(stations[who], frame(can_id, bytes([who] * 4), time_ns=at), 0)
        parts = [bus.run_until(cut).frames for cut in cuts]
        return np.concatenate([*parts, bus.run_until().frames])

    whole = run([])
    assert sorted(whole["can_id"].tolist()) == sorted(unique)
    starts = whole["time_ns"] + INTERMISSION_NS - frame_time_ns(whole, 1_000_000)
    assert (starts[1:] >= whole["time_ns"][:-1] + INTERMISSION_NS).all()
    assert all(start >= unique[int(f["can_id"])][1] for start, f in zip(starts.tolist(), whole, strict=True))
    cuts = sorted(draw.draw(st.lists(st.integers(0, 5_000_000), max_size=20)))
    assert run(cuts).tobytes() == whole.tobytes()


@pytest.mark.parametrize("count", [1, 300])
def test_records_keep_everything_but_time(count: int) -> None:
    bus, (one, _) = pair()
    sent = burst(range(count), 5)
    sent["port"] = np.arange(count) % 7
    bus.submit(one, sent, 1)
    got = bus.run_until().frames
    got["time_ns"] = 0
    assert got.dtype == FRAME
    assert got.tobytes() == sent.tobytes()


@pytest.mark.parametrize(
    ("other", "bits"),
    [
        (frame(0x100, b"\x01\x02\x03"), None),
        (frame(0x100, b"\x01\x02\x04"), 19 + 2 * 8),
        (frame(0x100, b"\x00\x02\x03"), 19),
        (frame(0x100, b"\x01\x02\x03\x00"), 19),  # another DLC
        (frame(0x100, b"\x01\x02\x03", FD), 19),
    ],
)
def test_equal_identifiers_clash_where_the_frames_differ(other: Frames, bits: int | None) -> None:
    one = frame(0x100, b"\x01\x02\x03")
    assert clash_bits(np.concatenate([one, other])) == bits
    assert clash_bits(np.concatenate([one, one, other])) == bits
