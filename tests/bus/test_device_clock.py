"""A controller's clock is followed by kernel stamps: computed stamps, as no such controller was there."""

import numpy as np
import pytest

from bus.device_clock import BUCKET_NS, LEAST_BUCKETS, DeviceClock

PERIOD_NS = 10_000_000
START_NS = 5_000_000_000_000
#: Least latency of the kernel's stamp.
LEAST_NS = 12_000


def stamps(seconds: float, drift: float, offset_ns: int = -START_NS) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return ends of SYNCs, and their device and kernel stamps: latencies of 12 us and more, some of milliseconds."""
    rng = np.random.default_rng(1)
    end_ns = START_NS + np.arange(round(seconds * 1e9), step=PERIOD_NS)
    latency_ns = LEAST_NS + rng.exponential(40_000, len(end_ns)) + 3e6 * (rng.random(len(end_ns)) < 0.02)
    device_ns = np.rint((end_ns - START_NS) * (1 + drift) + START_NS + offset_ns + 7_000).astype(np.int64)
    return end_ns, device_ns, end_ns + latency_ns.astype(np.int64)


def followed(clock: DeviceClock, device_ns: np.ndarray, kernel_ns: np.ndarray) -> np.ndarray:
    return np.array([clock.take(*each) for each in zip(device_ns.tolist(), kernel_ns.tolist(), strict=True)])


@pytest.mark.parametrize("drift", [0.0, 50e-6, -100e-6])
def test_the_jitter_of_the_kernel_is_gone(drift: float) -> None:
    end_ns, device_ns, kernel_ns = stamps(30, drift)
    clock = DeviceClock()
    found_ns = followed(clock, device_ns, kernel_ns)
    settled = end_ns - START_NS > 10e9
    late_ns = (found_ns - end_ns)[settled]
    assert np.abs(late_ns - LEAST_NS).max() < 10_000
    assert np.percentile((kernel_ns - end_ns)[settled], 99) > 1e6
    assert 0 < clock.error_ns < 20_000


def test_the_kernel_stamps_are_used_before_and_are_the_upper_limit() -> None:
    _, device_ns, kernel_ns = stamps(6, 20e-6)
    found_ns = followed(DeviceClock(), device_ns, kernel_ns)
    first = device_ns - device_ns[0] < (LEAST_BUCKETS - 1) * BUCKET_NS
    assert (found_ns[first] == kernel_ns[first]).all()
    assert (found_ns <= kernel_ns).all()


@pytest.mark.parametrize("jump_ns", [-4_000_000_000, 700_000_000])
def test_a_clock_that_begins_anew_is_followed_anew(jump_ns: int) -> None:
    end_ns, device_ns, kernel_ns = stamps(30, 20e-6)
    device_ns[1000:] += jump_ns
    found_ns = followed(DeviceClock(), device_ns, kernel_ns)
    assert (found_ns[1000:1100] == kernel_ns[1000:1100]).all()
    assert np.abs(found_ns - end_ns - LEAST_NS)[2000:].max() < 10_000


def test_the_line_is_not_used_after_a_pause() -> None:
    """Minutes without a frame: the clock has drifted elsewhere, by less than a jump, and no bucket tells."""
    _, device_ns, kernel_ns = stamps(30, 20e-6)
    pause_ns = 200_000_000_000
    later_device_ns, later_kernel_ns = device_ns[2000:] + pause_ns, kernel_ns[2000:] + pause_ns + 9_000_000
    clock = DeviceClock()
    followed(clock, device_ns[:2000], kernel_ns[:2000])
    assert clock.error_ns > 0
    found_ns = followed(clock, later_device_ns[:100], later_kernel_ns[:100])
    assert (found_ns == later_kernel_ns[:100]).all()
    assert clock.error_ns == 0


def test_the_line_is_used_after_a_second_without_frames() -> None:
    end_ns, device_ns, kernel_ns = stamps(30, 20e-6)
    there = (end_ns - START_NS < 20e9) | (end_ns - START_NS > 21e9)
    found_ns = followed(DeviceClock(), device_ns[there], kernel_ns[there])
    assert np.abs(found_ns - end_ns[there] - LEAST_NS)[2000:].max() < 10_000
