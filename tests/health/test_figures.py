"""Rates, latencies, and the image against the truth of its own cycle."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from health.state import ViewState
from health.window import Window
from skin.psnr import psnr_db


@pytest.fixture
def state(messages: Any) -> ViewState:
    return ViewState(messages.layout)


def test_rate_and_latency_of_the_last_seconds(state: ViewState, messages: Any) -> None:
    latencies_s = np.linspace(0.004, 0.012, 300)
    for cycle, latency_s in enumerate(latencies_s, 1):
        state.take(messages.image(cycle, sync_s=cycle / 100, latency_s=latency_s), cycle / 100)
    figures = state.snapshot(3.0)[0].figures
    assert figures.images_hz == pytest.approx(100, rel=0.02)
    assert figures.latency_p50_s == pytest.approx(np.percentile(latencies_s, 50), abs=1e-6)
    assert figures.latency_p99_s == pytest.approx(np.percentile(latencies_s, 99), abs=1e-6)
    later = state.snapshot(9.0)[0].figures
    assert (later.images_hz, later.latency_p50_s, later.latency_p99_s) == (0.0, None, None)


def test_images_of_which_nothing_was_measured_have_no_rate(state: ViewState, messages: Any) -> None:
    for cycle in range(1, 101):
        state.take(messages.image(cycle, invalid=tuple(range(8))), cycle / 100)
    figures = state.snapshot(1.0)[0].figures
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
    figures = state.snapshot(1.1)[0].figures
    assert figures.psnr_image_db == pytest.approx(20 * np.log10(0.02 / 0.001), abs=1e-3)
    assert figures.psnr_sensor_db == pytest.approx(20 * np.log10(0.02 / 0.002), abs=1e-3)
    assert state.snapshot(2.1)[0].figures.psnr_image_db is None


def test_same_counter_one_round_later_is_another_cycle(state: ViewState, messages: Any) -> None:
    state.take(messages.truth(3, sync_s=1.0), 1.0)
    state.take(messages.image(243, sync_s=3.4), 3.4)
    snapshot, _ = state.snapshot(3.4)
    assert snapshot.figures.psnr_image_db is None
    assert snapshot.truth is not None
    assert not snapshot.truth.of_image


def test_psnr_leaves_out_cycles_without_contact(state: ViewState, messages: Any) -> None:
    state.take(messages.truth(1, true=messages.grid(0.001)), 1.0)
    state.take(messages.image(1), 1.0)
    assert state.snapshot(1.0)[0].figures.psnr_image_db is None


def test_truth_shown_is_that_of_the_image_while_images_come(state: ViewState, messages: Any) -> None:
    state.take(messages.truth(1, true=messages.grid(0.005)), 1.0)
    state.take(messages.image(1), 1.0)
    state.take(messages.truth(2, sync_s=1.01, true=messages.grid(0.015)), 1.01)
    snapshot, pictures = state.snapshot(1.1)
    assert snapshot.truth is not None
    assert (snapshot.truth.step, snapshot.truth.of_image, snapshot.truth.label) == (1, True, "golf-ball")
    np.testing.assert_array_equal(pictures.true, messages.grid(0.005))
    state.take(messages.truth(3, sync_s=2.0), 2.0)
    snapshot, _ = state.snapshot(2.1)
    assert snapshot.truth is not None
    assert (snapshot.truth.step, snapshot.truth.of_image, snapshot.truth.stale) == (3, False, False)


def test_truth_of_the_image_is_shown_until_the_image_is_half_a_second_old(state: ViewState, messages: Any) -> None:
    state.take(messages.truth(1), 1.0)
    state.take(messages.image(1), 1.0)
    state.take(messages.truth(2, sync_s=1.25), 1.25)
    shown = [state.snapshot(now_s)[0].truth for now_s in (1.5, 1.50001)]
    assert [truth and truth.step for truth in shown] == [1, 2]


def test_truth_goes_stale_and_then_away(state: ViewState, messages: Any) -> None:
    state.take(messages.truth(1), 1.0)
    snapshot, pictures = state.snapshot(2.0)
    assert snapshot.truth is not None
    assert snapshot.truth.stale
    assert pictures.sensor is not None
    snapshot, pictures = state.snapshot(5.0)
    assert (snapshot.truth, pictures.true, pictures.sensor) == (None, None, None)


def test_psnr_of_equal_images_is_finite(messages: Any) -> None:
    assert psnr_db(messages.grid(), messages.grid(), 0.02) == pytest.approx(200)


@given(times=st.lists(st.floats(0, 100), min_size=1, max_size=60), now_s=st.floats(0, 110))
def test_window_holds_exactly_the_last_span(times: list[float], now_s: float) -> None:
    window = Window(2.0)
    times.sort()
    for time_s in times:
        window.add(time_s, time_s)
    now_s = max(now_s, times[-1])
    assert window.values(now_s) == [time_s for time_s in times if time_s > now_s - 2.0]


def test_rate_of_one_value_is_not_known() -> None:
    window = Window(1.0)
    assert window.rate_hz(0.0) == 0.0
    window.add(0.0, 1.0)
    assert window.rate_hz(0.0) == 0.0
    window.add(0.0, 1.0)
    assert window.rate_hz(0.0) > 0.0


def test_sensor_that_only_rounds_adds_no_noise(state: ViewState, messages: Any) -> None:
    true = messages.grid(0.01)
    step_n = messages.layout.taxels.force_max_n / 1023  # of 10 bits
    for now_s, error_n, adds in ((1.0, 0.0, False), (3.0, 0.49 * step_n, False), (5.0, 2 * step_n, True)):
        state.take(messages.truth(3, sync_s=now_s, true=true, sensor=true + np.float32(error_n)), now_s)
        state.take(messages.image(3, sync_s=now_s), now_s)
        assert state.snapshot(now_s + 0.1)[0].figures.sensor_adds_noise is adds
