"""The newest cycles as arrays and as one image."""

import dataclasses
import threading

import numpy as np
import pytest

from tests.client.lerobot_camera_canskin.conftest import (
    PERIOD_NS,
    ClockedSkin,
    force_n,
    frame,
    load_window,
    valid,
)

window = load_window()


@pytest.fixture
def buffer() -> window.WindowBuffer:
    return window.WindowBuffer(3, 4, 4)


def put(buffer: window.WindowBuffer, *cycles: int) -> None:
    for cycle in cycles:
        buffer.put(frame(cycle))


def read(buffer: window.WindowBuffer) -> window.TouchWindow:
    """Read whatever the age."""
    touch = buffer.read(np.inf)
    assert touch is not None
    return touch


def test_a_window_holds_the_newest_cycles_with_their_times(clocked: ClockedSkin, buffer: window.WindowBuffer) -> None:
    for cycle in range(1, 8):
        buffer.put(frame(cycle, clocked.sampled_ns(cycle)))
    clocked.now_ns = clocked.sampled_ns(7) + 4_000_000
    touch = buffer.read(0.005)
    assert touch.cycle.tolist() == [5, 6, 7]
    assert np.array_equal(touch.force_n, [force_n(cycle) for cycle in (5, 6, 7)])
    assert np.array_equal(touch.valid, [valid(cycle) for cycle in (5, 6, 7)])
    assert np.abs(touch.sampled_ns - [clocked.sampled_ns(cycle) for cycle in (5, 6, 7)]).max() < 300
    assert touch.age_s == pytest.approx([0.024, 0.014, 0.004])
    assert buffer.read(0.0039) is None


def test_a_skin_that_is_no_grid_is_a_line_for_each_cycle() -> None:
    buffer = window.WindowBuffer(2, 1, 16)
    for cycle in (1, 2):
        line = {"estimate": force_n(cycle).ravel(), "valid": valid(cycle).ravel()}
        buffer.put(dataclasses.replace(frame(cycle), **line))
    touch = read(buffer)
    assert touch.force_n.shape == (2, 1, 16)
    assert np.array_equal(touch.force_n[:, 0], [force_n(cycle).ravel() for cycle in (1, 2)])
    assert touch.image(1.0).shape == (2, 16, 3)


def test_a_cycle_without_a_frame_keeps_its_place_and_is_not_valid(buffer: window.WindowBuffer) -> None:
    put(buffer, 1, 2, 4)
    touch = read(buffer)
    assert touch.cycle.tolist() == [2, 3, 4]
    assert touch.valid.any(axis=(1, 2)).tolist() == [True, False, True]
    assert not touch.force_n[1].any()
    assert (touch.sampled_ns[1], touch.age_s[1]) == (0, -1)
    assert np.array_equal(touch.force_n[2], force_n(4))
    put(buffer, 20)
    assert read(buffer).valid.any(axis=(1, 2)).tolist() == [False, False, True]


def test_cycles_that_were_in_no_window_are_counted(buffer: window.WindowBuffer) -> None:
    put(buffer, 7, 8)
    read(buffer)
    put(buffer, 9, 10, 11)
    read(buffer)
    assert buffer.lost == 0
    put(buffer, 12, 13, 14, 15, 16)  # 12 and 13 do not fit
    read(buffer)
    read(buffer)
    assert buffer.lost == 2
    put(buffer, 18)  # 17 did not come
    read(buffer)
    assert buffer.lost == 3


def test_a_gateway_that_starts_anew_begins_a_window_of_its_own(buffer: window.WindowBuffer) -> None:
    put(buffer, 1, 2, 3)
    read(buffer)
    put(buffer, 2)
    touch = read(buffer)
    assert touch.cycle.tolist() == [0, 1, 2]
    assert touch.valid.any(axis=(1, 2)).tolist() == [False, False, True]
    assert buffer.lost == 0


def test_an_unknown_wall_clock_is_no_time(buffer: window.WindowBuffer) -> None:
    from dataclasses import replace

    buffer.put(replace(frame(3), sampled_at=np.nan))
    assert read(buffer).sampled_ns.tolist() == [0, 0, 0]


def test_a_reader_waits_for_a_frame_that_is_young_enough(clocked: ClockedSkin, buffer: window.WindowBuffer) -> None:
    assert not buffer.wait_for(1, 0.01, 1.0)
    clocked.now_ns = clocked.sampled_ns(1) + 10**9
    buffer.put(frame(1, clocked.sampled_ns(1)))
    assert not buffer.wait_for(1, 0.01, 0.5)
    later = threading.Timer(0.01, buffer.put, (frame(100, clocked.sampled_ns(100)),))
    later.start()
    assert buffer.wait_for(1, 20.0, 0.5)
    later.join()
    assert buffer.age_s == pytest.approx(1.01 - 100 * PERIOD_NS * 1e-9)


def test_an_image_is_force_and_what_was_not_measured(buffer: window.WindowBuffer) -> None:
    put(buffer, 6, 7)
    touch = read(buffer)
    image = touch.image(0.5)
    assert (image.shape, image.dtype) == ((12, 4, 3), np.uint8)
    missing, whole, half = image[:4], image[4:8], image[8:]
    assert np.array_equal(missing, np.broadcast_to((0, 0, 255), (4, 4, 3)))
    levels = [[min(255, round(force / 0.5 * 255)) for force in row] for row in force_n(6).astype(float)]
    assert np.array_equal(whole[..., 0], levels)
    assert np.array_equal(whole[..., 1], levels)
    assert not whole[..., 2].any()
    odd = np.arange(16).reshape(4, 4) % 2 == 1
    assert np.array_equal(half[..., 2], odd * 255)
    assert not half[..., 0][odd].any()
    assert half[..., 1][odd].any()


@pytest.mark.parametrize("form", ["camera", "data set"])
def test_forces_of_an_image_are_within_half_a_step(buffer: window.WindowBuffer, form: str) -> None:
    put(buffer, 5, 6, 7)
    touch = read(buffer)
    image = touch.image(1.0)
    if form == "data set":
        image = np.moveaxis(image, -1, 0).astype(np.float32) / 255
    force, is_valid = window.forces(image, 3, 1.0)
    assert force.dtype == np.float32
    assert np.abs(force - touch.force_n).max() <= 0.5 / 255 + 1e-6
    assert np.array_equal(is_valid, touch.valid)


def test_an_image_of_another_window_is_one_clear_error() -> None:
    with pytest.raises(ValueError, match=r"expected an image of 3 frames.*got \(16, 4, 3\)"):
        window.forces(np.zeros((16, 4, 3), np.uint8), 3, 1.0)
    with pytest.raises(ValueError, match=r"got \(4, 4\)"):
        window.forces(np.zeros((4, 4)), 1, 1.0)
