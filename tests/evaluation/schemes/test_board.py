"""Every scheme gets the samples of the same board, and nothing else of a touch."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from evaluation.schemes import schemes
from evaluation.schemes.board import Board, FilterName, board_of
from evaluation.schemes.comparison import SCHEMES
from evaluation.schemes.scenes import SIDE, SLAP, SLAP_MS, Touch
from evaluation.schemes.schemes import Scheme, measure_scheme
from touch.coarse_arrays import averaged

TOUCH = Touch("golf ball at rest", ticks=250)
UNTOUCHED = Touch("nothing", ticks=250)
UNSEEN = Touch(SLAP, ticks=SLAP_MS + 50)


@cache
def untouched_board(touch: Touch, side: int = SIDE) -> Board:
    """Give every scheme the board of a skin that nothing touches, whatever the touch."""
    assert touch == UNSEEN
    return board_of(replace(UNTOUCHED, ticks=touch.ticks), side)


@pytest.mark.slow
@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda scheme: scheme.name)
def test_no_scheme_sees_more_of_a_touch_than_its_board(scheme: Scheme, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(schemes, "board_of", untouched_board)
    monkeypatch.setattr(schemes, "default_kbit_per_s", lambda: 3100.0)
    pressed_n = UNSEEN.load().true_n
    unseen_mn = 1e3 * np.sqrt(np.mean(pressed_n[pressed_n > 0].astype(np.float64) ** 2))
    assert unseen_mn > 2
    # A raw sample of noise is not 0.
    assert measure_scheme(scheme, UNSEEN)["touched_error_mn"] == pytest.approx(unseen_mn, rel=0.2)


def test_a_coarse_array_has_the_noise_and_the_idle_seconds_of_the_skin() -> None:
    skin, coarse = board_of(UNTOUCHED), board_of(UNTOUCHED, 32)
    assert (coarse.counts.shape, coarse.idle.shape) == ((250, 1024), (len(skin.idle), 1024))
    for fine_counts, coarse_counts in ((skin.counts, coarse.counts), (skin.idle, coarse.idle)):
        assert coarse_counts.std() == pytest.approx(fine_counts.std(), rel=0.02)


@pytest.mark.heavy
@pytest.mark.parametrize("name", ["averaged", "patches"])
def test_every_filter_takes_out_noise_and_the_bias_of_clipping(name: FilterName) -> None:
    board = board_of(TOUCH, 16)
    true_n = averaged(TOUCH.load().true_n.reshape(-1, SIDE, SIDE), 16).reshape(250, -1)
    raw_n, raw_noise_n = board.filtered("raw")
    force_n, noise_n = board.filtered(name)
    assert noise_n == pytest.approx(1e-3, rel=0.1)
    assert raw_noise_n == pytest.approx(1e-3, rel=0.1)
    idle = true_n[-50:] == 0
    assert raw_n[-50:][idle].mean() == pytest.approx(0.4e-3, rel=0.1)
    assert force_n[-50:][idle].mean() < 0.02e-3
    raw_error_n, error_n = (np.sqrt(np.mean((each - true_n)[-50:] ** 2)) for each in (raw_n, force_n))
    assert error_n < 0.5 * raw_error_n
