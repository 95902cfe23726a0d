"""Each difference of a log of adaptive nodes from the layout, in a log of a few frames written here."""

from dataclasses import replace

import numpy as np
import pytest

from bandwidth.adaptive_log import AdaptiveLoad, measure_adaptive
from bandwidth.adaptive_plan import plan_adaptive
from bandwidth.departures import departures
from bandwidth.measured import Identifiers, Measured, measure
from dbc.adaptive import check_of, pack_fine
from dbc.contract import Contract
from dbc.frame import BRS, ERROR, EXTENDED, FD, REMOTE, Frames, frames
from dbc.frame_bits import frame_time_ns
from tests.layouts import ADAPTIVE, buses, small_layout

MS = 1_000_000
CONTRACT = Contract.from_layout(small_layout(**ADAPTIVE, bus=buses(2, names=["arm"])))
#: Of node 1: coarse frames of groups 0 and 1 at the highest level, and of group 0 at the lowest; a fine frame.
COARSE, OTHER, LOWEST, FINE = 0x181, 0x1A1, 0x401, 0x481
VALUES = bytes([200] * 8)


def one(time_ms: float, can_id: int, data: bytes) -> Frames:
    found = frames(1)
    found["time_ns"], found["can_id"], found["length"] = round(time_ms * MS), can_id, len(data)
    found["data"][0, : len(data)] = tuple(data)
    return found


def log(*more: Frames) -> Frames:
    """Return two seconds with SYNC every 100 ms and heartbeats every 500 ms, and `more`."""
    syncs = [one(100.0 * turn, 0x80, bytes([turn + 1])) for turn in range(21)]
    beats = [one(500.0 * turn + 50 + node, 0x700 + node, b"\5") for turn in range(4) for node in (1, 2)]
    seen: Frames = np.concatenate([*syncs, *beats, *more])
    return seen[np.argsort(seen["time_ns"], kind="stable")]


def said(*more: Frames, refresh_ms: float | None = None) -> list[str]:
    """Return what is said of a log; a refresh ends `refresh_ms` after it is due at most."""
    planned = replace(plan_adaptive(CONTRACT, is_touched=False)[0], refresh_ms=refresh_ms)
    seen = log(*more)
    return departures(CONTRACT, 0, seen, [Measured(0, seen, planned, measure(CONTRACT, 0, seen, planned))])


def fine(time_ms: float, coarse: bytes, *, wrong: int = 0, node: int = 1) -> Frames:
    payload = np.zeros(8, np.uint8)
    pack_fine(np.zeros(8, np.int64), int(check_of(np.frombuffer(coarse, np.uint8))) ^ wrong, payload)
    return one(time_ms, FINE + node - 1, payload.tobytes())


@pytest.mark.heavy
def test_a_log_that_keeps_the_layout_has_no_difference() -> None:
    assert said() == []
    assert said(one(10, COARSE, VALUES), fine(20, VALUES), one(30, LOWEST, VALUES)) == []


def test_sums_begin_two_milliseconds_after_a_sync() -> None:
    """A log tells the begin to 0.1 ms. The first frame behind a SYNC may have been on its way."""
    took_ms = float(frame_time_ns(one(0, COARSE, VALUES), 1_000_000, None)[0]) / MS
    after = one(200.2, 0x702, b"\5"), one(300.2, 0x702, b"\5")
    assert said(*after, one(201.9 + took_ms, COARSE, VALUES)) == []
    assert said(one(200.5, COARSE, VALUES)) == []
    line = "arm: node 1: 2 frames of sums began in the 2 ms after a SYNC"
    assert said(*after, one(201.899999 + took_ms, COARSE, VALUES), one(300.9, OTHER, VALUES)) == [line]


def test_fine_frames_refine_the_newest_coarse_frame_of_their_group() -> None:
    other = bytes(range(8))
    line = "arm: node 1: {} fine frames do not refine the newest coarse frame of their group"
    assert said(fine(5, VALUES)) == []  # the coarse frame was before the log
    assert said(one(10, COARSE, VALUES), one(20, COARSE, other), fine(30, VALUES)) == [line.format(1)]
    assert said(one(10, COARSE, VALUES), fine(20, VALUES, wrong=1), fine(30, VALUES, wrong=128)) == [line.format(2)]
    assert said(one(10, COARSE, VALUES), one(20, OTHER, other), fine(30, VALUES)) == []
    assert said(one(10, COARSE + 1, VALUES), one(20, COARSE, other), fine(30, VALUES, node=2)) == []


def test_frames_of_sums_have_eight_bytes() -> None:
    found = said(one(10, COARSE, VALUES[:7]), one(20, COARSE + 1, VALUES[:7]), one(30, FINE + 1, VALUES[:6]))
    words = "TPDOs have another length or format"
    assert found == [f"arm: node 1: 1 {words}", f"arm: node 2: 2 {words}"]


@pytest.mark.parametrize(
    ("first_ms", "values", "is_silent"),
    [
        (375.5, VALUES, True),  # to the end of the log, 2000 ms
        (376.5, VALUES, False),
        (10.0, bytes([0] + 7 * [128]), False),  # all sums are 0
        (10.0, bytes([1] + 7 * [128]), True),
        (10.0, bytes([0, *6 * [128], 127]), True),
    ],
)
def test_a_group_that_is_not_0_is_sent_again(first_ms: float, values: bytes, is_silent: bool) -> None:
    """1024 ms, 500 ms until the refresh ends, and 100 ms."""
    line = "arm: node 1: group 0 was silent for {:.1f} s, its sums are not 0; a frame every 1.6 s was planned"
    wanted = [line.format((2000 - first_ms) / 1000)] if is_silent else []
    assert said(one(first_ms, COARSE, values), refresh_ms=500.0) == wanted
    assert said(one(first_ms, COARSE, values)) == []  # a bus without a bound


def test_the_longest_silence_is_named() -> None:
    rows = one(10, OTHER, VALUES), one(1710, OTHER, VALUES), one(1720, COARSE, VALUES)
    assert said(*rows, refresh_ms=500.0) == [
        "arm: node 1: group 1 was silent for 1.7 s, its sums are not 0; a frame every 1.6 s was planned"
    ]


def test_a_log_with_less_than_two_syncs_has_no_pauses() -> None:
    planned = plan_adaptive(CONTRACT, is_touched=False)[0]
    seen = log()
    for syncs, words in ((2, None), (1, "one"), (0, "no")):
        left = seen[(seen["can_id"] != 0x80) | (np.cumsum(seen["can_id"] == 0x80) <= syncs)]
        found = departures(CONTRACT, 0, left, [Measured(0, left, planned, measure(CONTRACT, 0, left, planned))])
        assert found == ([] if words is None else [f"arm: {words} SYNC: pauses cannot be checked"])


def measured(*more: Frames) -> AdaptiveLoad:
    planned, seen = plan_adaptive(CONTRACT, is_touched=False)[0], log(*more)
    return measure_adaptive(CONTRACT, 0, seen, measure(CONTRACT, 0, seen, planned))


def test_frames_are_counted_by_level_and_by_what_they_say() -> None:
    load = measured(
        one(10, COARSE, VALUES), one(20, LOWEST, VALUES), one(30, COARSE, bytes(8)), one(40, OTHER, VALUES),
        fine(50, bytes(8)), fine(60, VALUES), fine(70, VALUES, node=2), one(80, COARSE + 1, VALUES),
    )  # fmt: skip
    counts = {(level.kind, level.level): level.frames for level in load.levels}
    assert list(counts) == [*(("coarse", level) for level in (5, 4, 3, 2, 1, 0)), ("fine", 1), ("fine", 0)]
    assert {key: count for key, count in counts.items() if count} == {
        ("coarse", 5): 4,
        ("coarse", 0): 1,
        ("fine", 1): 3,
    }
    assert [level.rate_hz for level in load.levels if level.frames] == pytest.approx([2.0, 0.5, 1.5])
    first, second = load.nodes
    assert (first.node_id, first.news, first.again, first.fine, first.unrefined, first.heartbeats) == (1, 3, 1, 2, 1, 4)
    assert (second.node_id, second.news, second.again, second.fine, second.unrefined) == (2, 1, 0, 1, 0)
    # 4 heartbeats, and 3 of frames of 8 bytes, in two seconds: below the most stuff bits, above none.
    assert (4 * 55 + 2 * 111) / 2e6 < second.load_exact < (4 * 65 + 2 * 135) / 2e6


def test_sums_have_1024_identifiers_of_which_a_node_owns_every_32nd() -> None:
    identifiers = [0x180, 0x181, 0x182, 0x183, 0x1A0, 0x1A1, 0x561, 0x562, 0x580, 0x581, 0x582]
    seen = np.concatenate([one(0, can_id, VALUES) for can_id in identifiers])
    wanted = [False, True, True, False, False, True, True, True, False, False, False]
    assert Identifiers(CONTRACT, 0).is_sums(seen).tolist() == wanted
    kinds = [Identifiers(CONTRACT, 0).kind_of(can_id) for can_id in identifiers]
    assert [kind in {"coarse", "fine"} for kind, _ in kinds] == wanted
    assert [node for (_, node), is_sum in zip(kinds, wanted, strict=True) if is_sum] == [1, 2, 1, 1, 2]
    for flag in (EXTENDED, REMOTE, ERROR):
        seen["flags"] = flag
        assert not Identifiers(CONTRACT, 0).is_sums(seen).any()


def test_frames_of_sums_have_the_format_of_their_bus() -> None:
    on_fd = Contract.from_layout(small_layout(**ADAPTIVE, bus=buses(2, fd=True, data_bitrate=2_000_000)))
    for contract, last, lengths, flags in (
        (CONTRACT, (0x462, 0x562), (8, 8), 0),
        (on_fd, (0x402, 0x502), (32, 64), FD | BRS),
    ):
        # The first and the last coarse frame, and the first and the last fine frame.
        seen = np.concatenate([one(0, can_id, bytes(64)) for can_id in (0x181, last[0], 0x481, last[1])])
        seen["length"], seen["flags"] = np.repeat(lengths, 2), flags
        assert Identifiers(contract, 0).is_right(seen).all()
        seen["flags"] ^= FD
        assert not Identifiers(contract, 0).is_right(seen).any()
        seen["flags"] ^= FD | BRS
        assert not Identifiers(contract, 0).is_right(seen).any()
        seen["flags"], seen["length"] = flags, seen["length"] - 1
        assert not Identifiers(contract, 0).is_right(seen).any()
