"""Rates, latencies, and the image against the truth of its own cycle."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from health.state import ViewState
from health.window import Rate, Window
from tests.health.helpers import seen_of


@pytest.fixture
def state(messages: Any) -> ViewState:
    return ViewState(messages.layout)


def test_images_of_which_nothing_was_measured_have_no_rate(state: ViewState, messages: Any) -> None:
    for cycle in range(1, 101):
        state.take(messages.image(cycle, invalid=tuple(range(8))), cycle / 100)
    figures = seen_of(state, 1.0).figures
    assert (figures.images_hz, figures.latency_p50_s, figures.valid_blocks) == (0.0, None, 0)


@pytest.mark.parametrize("truth_first", [True, False])
def test_psnr_is_that_of_the_same_cycle(state: ViewState, messages: Any, truth_first: bool) -> None:
    true = messages.grid(0.01)
    sensor, pixels = true + np.float32(0.002), true + np.float32(0.001)
    takes: list[Callable[[], None]] = [
        lambda: state.take(messages.truth(3, true=true, sensor=sensor), 1.0),
        lambda: state.take(messages.image(3, pixels=pixels), 1.0),
    ]
    for take in takes if truth_first else reversed(takes):
        take()
    figures = seen_of(state, 1.1).figures
    assert figures.psnr_image_db == pytest.approx(20 * np.log10(0.02 / 0.001), abs=1e-3)
    assert figures.psnr_sensor_db == pytest.approx(20 * np.log10(0.02 / 0.002), abs=1e-3)
    assert seen_of(state, 2.1).figures.psnr_image_db is None


def test_same_counter_one_round_later_is_another_cycle(state: ViewState, messages: Any) -> None:
    state.take(messages.truth(3, sync_s=1.0), 1.0)
    state.take(messages.image(243, sync_s=3.4), 3.4)
    snapshot = seen_of(state, 3.4)
    assert snapshot.figures.psnr_image_db is None
    assert snapshot.truth is None


def test_psnr_leaves_out_cycles_without_contact(state: ViewState, messages: Any) -> None:
    state.take(messages.truth(1, true=messages.grid(0.001)), 1.0)
    state.take(messages.image(1), 1.0)
    assert seen_of(state, 1.0).figures.psnr_image_db is None


def test_truth_shown_is_always_that_of_the_image(state: ViewState, messages: Any) -> None:
    state.take(messages.truth(1, true=messages.grid(0.005)), 1.0)
    assert seen_of(state, 1.0).truth is None  # of no image
    state.take(messages.image(1), 1.0)
    state.take(messages.truth(2, sync_s=1.01, true=messages.grid(0.015)), 1.01)
    for now_s, stale in ((1.1, False), (2.1, True)):
        snapshot, pictures = state.snapshot(now_s)
        assert (snapshot.truth.step, snapshot.truth.stale, snapshot.truth.label) == (1, stale, "golf-ball")
        np.testing.assert_array_equal(pictures.true, messages.grid(0.005))
    state.take(messages.image(3, sync_s=1.02), 2.2)
    snapshot, pictures = state.snapshot(2.2)
    assert (snapshot.truth, pictures.true, pictures.sensor) == (None, None, None)
    state.take(messages.truth(3, sync_s=1.02), 2.3)
    assert seen_of(state, 2.3).truth is not None


@given(times=st.lists(st.floats(0, 100), min_size=1, max_size=60), now_s=st.floats(0, 110))
def test_window_holds_exactly_the_last_span(times: list[float], now_s: float) -> None:
    window = Window(2.0)
    times.sort()
    for time_s in times:
        window.add(time_s, time_s)
    now_s = max(now_s, times[-1])
    assert window.values(now_s) == [time_s for time_s in times if time_s > now_s - 2.0]


@given(
    period_s=st.floats(0.002, 0.2),
    waits_s=st.lists(st.floats(0, 3), min_size=2, max_size=60),
    after_s=st.floats(0, 3),
)
def test_images_in_a_burst_after_a_stall_are_no_more_than_the_syncs(
    period_s: float, waits_s: list[float], after_s: float
) -> None:
    rate, now_s = Rate(1.0), 0.0
    for cycle, wait_s in enumerate(waits_s):
        now_s = max(now_s + (wait_s if cycle % 7 == 0 else 0.0), cycle * period_s)
        rate.add(now_s, cycle * period_s)
        assert rate.per_s(now_s) <= (1 + 1e-9) / period_s
    assert rate.per_s(now_s + after_s) <= (1 + 1e-9) / period_s
    assert rate.per_s(now_s + 1.1) == 0.0


def test_sensor_that_only_rounds_adds_no_noise(state: ViewState, messages: Any) -> None:
    true = messages.grid(0.01)
    step_n = messages.layout.taxels.force_max_n / 1023  # of 10 bits
    for now_s, error_n, adds in ((1.0, 0.0, False), (3.0, 0.49 * step_n, False), (5.0, 2 * step_n, True)):
        state.take(messages.truth(3, sync_s=now_s, true=true, sensor=true + np.float32(error_n)), now_s)
        state.take(messages.image(3, sync_s=now_s), now_s)
        assert seen_of(state, now_s + 0.1).figures.sensor_adds_noise is adds
