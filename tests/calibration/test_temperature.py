"""The zero follows temperatures once it has fallen with them, and none that explain nothing."""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pytest

from calibration.temperature import TemperatureModel
from skin.zero_drift import REST_K
from tests.calibration.helpers import COUNTS, SMALL_COUNT_N, SMALL_PHI, Cycles, offsets_of, pressed_counts, tared

Floats = npt.NDArray[np.float64]
BOARDS = 4
N_PER_K = 0.5e-3
EVEN = np.zeros(BOARDS)


class Boards:
    """Boards whose zero falls at once with the truth, and rises by what the temperature tells alone."""

    def __init__(self) -> None:
        self.model = TemperatureModel(BOARDS)
        self.kelvin, self.zero_n = np.full(BOARDS, REST_K), np.zeros(BOARDS)

    def take(self, kelvin: Floats | float, true_n: Floats | float) -> Floats:
        """Let the next readings come; return what they tell."""
        self.zero_n = np.minimum(self.zero_n, true_n)
        told_n = self.model.take(np.broadcast_to(np.asarray(kelvin, float), BOARDS), self.zero_n)
        self.zero_n = self.zero_n + told_n
        return told_n

    def cool(self, readings: int = 20, per_reading_k: float = 0.5) -> None:
        for reading in range(readings):
            off_k = -per_reading_k * reading
            assert np.abs(self.take(REST_K + off_k, N_PER_K * off_k)).max() < 1e-9  # the zero has fallen by itself


def test_a_rise_at_any_speed_is_followed_after_a_fall() -> None:
    boards = Boards()
    boards.cool()
    assert boards.model.newton_per_k == pytest.approx(N_PER_K)
    assert boards.take(REST_K, 0.0) == pytest.approx(EVEN + 9.5 * N_PER_K)
    assert boards.take(REST_K - 2, -2 * N_PER_K) == pytest.approx(EVEN, abs=1e-9)
    assert boards.take(REST_K + 3, 3 * N_PER_K) == pytest.approx(EVEN + 5 * N_PER_K)


def test_each_board_moves_by_its_own_temperature() -> None:
    boards = Boards()
    boards.cool()
    off_k = np.array([-9.5, -5.0, 0.0, 4.0])
    assert boards.take(REST_K + off_k, N_PER_K * off_k) == pytest.approx(N_PER_K * (off_k + 9.5))


def test_what_the_zero_has_moved_already_is_not_told_again() -> None:
    boards = Boards()
    boards.cool()
    boards.zero_n += 1e-3  # by a slow rise
    assert boards.take(REST_K - 5.5, -5.5 * N_PER_K) == pytest.approx(EVEN + 1e-3)


@pytest.mark.parametrize("off_k", [lambda reading: 0.1 * (reading % 2), lambda reading: 3.0 * (reading % 2)])
def test_nothing_is_learned_of_temperatures_that_explain_nothing(off_k: Callable[[int], float]) -> None:
    """They hardly change, or otherwise than the zero."""
    boards = Boards()
    for reading in range(60):
        assert not boards.take(REST_K + off_k(reading), -1e-4 * reading).any()
    assert boards.model.newton_per_k == 0


def test_what_a_temperature_explained_is_forgotten_when_the_zero_goes_another_way() -> None:
    boards = Boards()
    boards.cool()
    for reading in range(40):
        boards.take(REST_K - 9.5, -5e-3 - 1e-3 * reading)
    assert boards.model.newton_per_k == 0
    assert not boards.take(REST_K, 0.0).any()


def test_a_board_without_temperature_stays_and_catches_up() -> None:
    boards = Boards()
    boards.cool()
    known = np.array([True, True, False, True])
    told_n = boards.take(np.where(known, REST_K - 5.5, np.nan), -5.5 * N_PER_K)
    assert told_n == pytest.approx(np.where(known, 4 * N_PER_K, 0.0))
    assert boards.take(REST_K - 5.5, -5.5 * N_PER_K) == pytest.approx(np.where(known, 0.0, 4 * N_PER_K), abs=1e-9)


def test_a_new_zero_keeps_the_coefficient_and_is_compared_with_none_before() -> None:
    boards = Boards()
    boards.cool()
    boards.model.restart()
    boards.zero_n[:] = 0
    assert not boards.take(REST_K - 9.5, 0.0).any()
    assert boards.take(REST_K - 5.5, 2e-3) == pytest.approx(EVEN + 4 * N_PER_K)


def cooled() -> tuple[Cycles, Callable[[float, float], list[int]]]:
    """Return a small skin that has cooled by 3 mN in half a minute, and how it goes on for windows at an offset."""
    skin = tared()

    def run(windows: float, off_n: float) -> list[int]:
        made = skin.run(windows, COUNTS + pressed_counts(0, 0, 32, round(off_n / SMALL_COUNT_N)))
        skin.made.take_temperatures(np.full(SMALL_PHI.blocks, REST_K + off_n / N_PER_K))
        return offsets_of(made)

    for step in range(16):
        run(8, -2e-4 * step)
    return skin, run


@pytest.mark.heavy
@pytest.mark.parametrize("is_tared", [False, True])
def test_a_skin_that_has_cooled_follows_a_fast_rise(is_tared: bool) -> None:
    """Also after its zero was measured anew."""
    skin, run = cooled()
    if is_tared:
        skin.made.tare(force=True)
        run(12, -3e-3)
        assert skin.made.result is not None
        assert skin.made.result.is_done
    run(4, 0.0)
    assert run(1, 0.0) == pytest.approx(COUNTS, abs=0.15e-3 * 32 / SMALL_COUNT_N)
    assert skin.made.status().doubtful_taxels == 0


def test_before_the_first_zero_and_without_a_zero_that_is_followed_temperatures_tell_nothing() -> None:
    for skin in (Cycles(), Cycles(tares=False, offsets_n=COUNTS * SMALL_COUNT_N)):
        before = skin.made.offsets_n
        for off_k in range(20):
            skin.made.take_temperatures(np.full(SMALL_PHI.blocks, REST_K - off_k))
        np.testing.assert_array_equal(skin.made.offsets_n, before)
