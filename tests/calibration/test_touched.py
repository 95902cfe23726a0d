"""A touch is told from offsets and noise by its pattern alone."""

import numpy as np
import pytest

from calibration.touched import TouchFinder
from skin.layout import parse_layout
from tests.calibration.skins import COLUMNS, PHI, ROWS, offsets_n, pressed

ALL = np.ones(PHI.shape[0], np.bool_)


@pytest.fixture(scope="module")
def finder() -> TouchFinder:
    return TouchFinder(PHI, ROWS, COLUMNS)


def test_offsets_are_no_touch(finder: TouchFinder) -> None:
    for seed in range(100):
        touch = finder.look(PHI.forward(offsets_n(seed)), ALL, 1e-4)
        assert not touch.is_touched
        assert not touch.is_negative
        assert not touch.blocks.any()


def test_an_offset_that_all_taxels_share_is_no_touch(finder: TouchFinder) -> None:
    touch = finder.look(PHI.forward(offsets_n() + 0.01), ALL, 1e-4)
    assert not touch.is_touched


@pytest.mark.parametrize(("size", "force_n"), [(3, 0.006), (5, 0.004), (9, 0.0025), (20, 0.005), (32, 0.005)])
def test_a_touch_on_unknown_offsets_is_found(finder: TouchFinder, size: int, force_n: float) -> None:
    for seed in range(10):
        force = pressed(20, 30, size, force_n)
        touch = finder.look(PHI.forward(offsets_n(seed) + force), ALL, 1e-4)
        assert touch.is_touched
        assert 20 <= touch.row < 20 + size
        assert 30 <= touch.column < 30 + size


def test_with_known_offsets_a_faint_touch_is_found(finder: TouchFinder) -> None:
    noise = np.random.default_rng(0).normal(0, 2e-4, PHI.shape[0])
    assert not finder.look(noise, ALL, 2e-4).is_touched
    assert finder.look(noise + PHI.forward(pressed(40, 9, 3, 0.3e-3)), ALL, 2e-4).is_touched


def test_forces_below_zero_are_told_from_a_touch(finder: TouchFinder) -> None:
    noise = np.random.default_rng(0).normal(0, 2e-4, PHI.shape[0])
    touch = finder.look(noise - PHI.forward(pressed(40, 9, 5, 2e-3)), ALL, 2e-4)
    assert touch.is_negative
    assert not touch.is_touched


def test_missing_blocks_do_not_matter(finder: TouchFinder) -> None:
    known = PHI.sums_of_blocks(np.arange(PHI.blocks) % 4 > 0)
    nonsense = np.where(known, 0, 1e3)
    assert not finder.look(PHI.forward(offsets_n()) + nonsense, known, 1e-4).is_touched
    assert finder.look(PHI.forward(offsets_n() + pressed(5, 5, 9, 0.005)) + nonsense, known, 1e-4).is_touched


def test_of_patches_only_those_under_the_touch_and_around_are_held() -> None:
    layout = parse_layout(b"[taxels]\nrows = 64\ncolumns = 64\n[measurement]\nwiring = 'board'\nsums = 4096", "test")
    phi = layout.phi()
    finder = TouchFinder(phi, 64, 64)
    noise = np.random.default_rng(0).normal(0, 2e-4, phi.shape[0])
    touch = finder.look(noise + phi.forward(pressed(4, 4, 5, 0.01)), np.ones(phi.shape[0], np.bool_), 2e-4)
    under = {int(block) for block in range(phi.blocks) if pressed(4, 4, 5, 1)[phi.taxels_of_blocks[block]].any()}
    assert under <= set(np.flatnonzero(touch.blocks).tolist())
    assert touch.blocks.sum() < phi.blocks / 3
