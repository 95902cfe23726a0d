"""All buses of one SYNC cycle measure one moment, however late each of them is read."""

import numpy as np
import pytest

from nodes.electronics import Electronics
from nodes.sampler import Sampler
from skin.layout import load_layout
from skin.sources import Frame

MS = 1_000_000


class Steps:
    """A source that tells by the first taxel which step it is, and counts how often it is asked."""

    has_noise = True

    def __init__(self) -> None:
        self.asked: list[int] = []

    def frame(self, step: int) -> Frame:
        self.asked.append(step)
        force_n = np.zeros((64, 64), np.float32)
        force_n[0, 0] = 0.0001 * step
        return Frame(force_n, "")


@pytest.fixture
def source() -> Steps:
    return Steps()


@pytest.fixture
def sampler(source: Steps) -> Sampler:
    skin = load_layout()
    return Sampler(skin.phi(), source, Electronics(skin.taxels, noise_n=0.0))


def test_a_bus_whose_sync_comes_late_measures_the_same_moment(sampler: Sampler, source: Steps) -> None:
    first = sampler.sample(1, 0)
    for late_ms in (1, 5, 30, 90):
        assert sampler.sample(1, late_ms * MS) is first
    assert source.asked == [0]


def test_buses_that_are_read_one_after_the_other_measure_the_same_moments(sampler: Sampler, source: Steps) -> None:
    one = [sampler.sample(counter, 10 * MS * counter) for counter in (1, 2, 3)]
    other = [sampler.sample(counter, 10 * MS * counter + MS) for counter in (1, 2, 3)]
    assert all(mine is theirs for mine, theirs in zip(one, other, strict=True))
    assert source.asked == [0, 1, 2]


def test_a_missed_sync_skips_its_step_and_the_counter_wraps(sampler: Sampler, source: Steps) -> None:
    for place, counter in enumerate((238, 240, 1, 4)):
        sampler.sample(counter, 10 * MS * place)
    assert source.asked == [237, 239, 240, 243]


def test_syncs_without_counter_are_told_apart_by_time(sampler: Sampler, source: Steps) -> None:
    for time_ns in (0, MS, 5 * MS, 6 * MS):
        sampler.sample(0, time_ns)
    assert source.asked == [0, 1]


def test_a_counter_that_comes_round_again_is_another_cycle(sampler: Sampler, source: Steps) -> None:
    sampler.sample(7, 0)
    sampler.sample(7, 120 * MS)
    assert source.asked == [6, 7]
