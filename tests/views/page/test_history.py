"""The last minutes of a skin: ten moments a second, null where nothing was measured, and bounded frames."""

import struct
from typing import Any

import msgspec
import pytest

from canskin.connection import RECORDER
from canskin.messages import Mark
from canskin.peers import new_peer
from health.snapshot import Moment
from health.state import ViewState
from views.page.history import FRAMES_BYTES, PERIOD_S, SPAN_S, History

NOTHING = Moment(None, None, None, None, None, None, None)


def history_of(state: ViewState, size: int = 100) -> History:
    return History(state.moment, lambda time_s: struct.pack("<d", time_s) + bytes(size - 8))


@pytest.fixture
def state(messages: Any) -> ViewState:
    return ViewState(messages.layout)


def test_moments_tell_what_was_measured_and_null_in_a_gap(state: ViewState, messages: Any) -> None:
    history = history_of(state)
    for number in range(200, 300):
        at_s = number / 100
        history.look(at_s)
        missing = 3 if at_s >= 2.5 else 0
        state.take(messages.image(number, sync_s=at_s, latency_s=0.004), at_s)
        state.take(messages.contacts(number, sync_s=at_s), at_s)
        state.take(messages.label(cycle=number, sync_s=at_s), at_s)
        state.take(messages.gateway(missing=missing), at_s)
    history.look(6.0)
    told = history.since(2.05)
    assert told["time_s"] == pytest.approx([2.1 + PERIOD_S * place for place in range(40)])
    force_n = float(messages.grid().sum())
    assert told["force_n"][:9] == pytest.approx([force_n] * 9, rel=1e-4)
    assert told["latency_s"][:9] == pytest.approx([0.004] * 9)
    first = [told[name][0] for name in ("load_ratio", "label", "mark", "contacts")]
    assert first == [0.8, "golf-ball", None, [(7, round(force_n, 6))]]
    assert sum(each or 0 for each in told["lost"]) == 3
    for name, column in told.items():
        assert len(column) == 40
        assert name == "time_s" or column[-1] is None  # no zero where nothing came
    assert history.since(6.0)["time_s"] == []


def test_a_mark_lasts_until_the_next_or_the_end_of_the_recorder(state: ViewState) -> None:
    recorder = new_peer("palm", RECORDER, "")
    state.take_peer(recorder, True, 1.0)
    marks = []
    for label in ("cup", "x" * 65, " ball"):
        assert state.take(Mark(label=label), 2.0) == (label == "cup")
        marks.append(state.moment(2.0).mark)
    state.take(Mark(label=""), 3.0)
    marks.append(state.moment(1e6).mark)
    state.take_peer(recorder, False, 1e6)
    assert [*marks, state.moment(1e6).mark] == ["cup", "cup", "cup", "", None]


def test_a_skin_of_which_nothing_is_measured_has_no_force_and_no_zero(state: ViewState, messages: Any) -> None:
    state.take(messages.image(invalid=tuple(range(8))), 1.0)
    state.take(messages.contacts(blind=True), 1.0)
    state.take(messages.label("", 0.0, valid_sums=0), 1.0)
    assert state.moment(1.1) == NOTHING


def test_the_last_five_minutes_are_kept_and_a_long_pause_costs_nothing() -> None:
    asked: list[float] = []

    def moment(time_s: float) -> Moment:
        asked.append(time_s)
        return NOTHING

    history = History(moment, lambda _: b"")
    history.look(1e9)
    history.look(1e9 + 10 * SPAN_S)
    assert len(asked) == 2
    history.look(1e9 + 11.5 * SPAN_S)
    assert len(asked) == 3
    for place in range(round(1.2 * SPAN_S)):
        history.look(2e9 + place)
    assert len(history.since(0)["time_s"]) == SPAN_S / PERIOD_S


def test_the_nearest_frame_is_given_and_none_of_a_time_without() -> None:
    history = History(lambda _: NOTHING, lambda time_s: struct.pack("<d", time_s))
    for place in range(31):
        history.look(100 + place / 10)
    assert struct.unpack("<d", history.frame(101.52) or b"")[0] == pytest.approx(101.5)
    assert history.frame(float("inf")) is None
    assert history.frame(50.0) is None


def test_frames_keep_within_their_memory_over_the_whole_span() -> None:
    size = FRAMES_BYTES // 50
    history = History(lambda _: NOTHING, lambda time_s: struct.pack("<d", time_s) + bytes(size - 8))
    for place in range(round(1.5 * SPAN_S * 2)):
        history.look(1000 + place / 2)
    kept = {content for place in range(600) if (content := history.frame(1000 + place)) is not None}
    assert 45 <= len(kept) <= 50
    oldest_s = min(struct.unpack_from("<d", each)[0] for each in kept)
    assert oldest_s <= 1000 + 1.5 * SPAN_S - 0.9 * SPAN_S


def test_a_single_snapshot_has_the_psnr_of_its_image(state: ViewState, messages: Any) -> None:
    state.take(messages.truth(3), 1.0)
    state.take(messages.image(3, pixels=messages.grid() + 0.002), 1.0)
    single, mean = (state.snapshot(1.0, is_single=each)[0].figures for each in (True, False))
    assert msgspec.structs.astuple(single) == msgspec.structs.astuple(mean)
    assert single.psnr_image_db == pytest.approx(20.0, abs=1e-3)
