"""The engine: better than the sensor, never negative, no ghosts, and sensible where blocks are silent."""

from dataclasses import replace

import numpy as np
import pytest

from canskin.errors import InputError
from reconstructor.engine import TURNS_PENALTY, Reconstructor
from reconstructor.settings import LIVE, PAPER, PAPER_CONTOURLET, SPUN, VARIATION, SolverSettings, preset
from skin.phi import Sbhe
from tests.reconstructor.helpers import Scene, ball, psnr_db, sense

ALL_VALID = np.ones(1024, np.bool_)


def images(phi: Sbhe, scene: Scene, settings: SolverSettings = LIVE, *, cold: bool = False) -> np.ndarray:
    engine = Reconstructor(phi, 64, 64, settings)
    frames = []
    for sums in scene.sums:
        if cold:
            engine.reset()
        frames.append(engine.solve(sums, ALL_VALID))
    return np.stack(frames)


def test_image_is_better_than_the_sensor_and_than_the_papers_mode(phi: Sbhe, golf: Scene) -> None:
    sensor = psnr_db(golf.sensor, golf.true).mean()
    live = psnr_db(images(phi, golf), golf.true)
    paper = psnr_db(images(phi, golf, PAPER), golf.true)
    assert sensor == pytest.approx(29.0, abs=0.2)
    assert paper.mean() == pytest.approx(31.2, abs=0.6)  # Table III, golf ball, Haar, 20 iterations: 31.1 dB
    contourlet = psnr_db(images(phi, golf, PAPER_CONTOURLET), golf.true)
    assert contourlet.mean() == pytest.approx(36.4, abs=1)  # the same, contourlet
    assert live.mean() > sensor + 4
    assert live.mean() > paper.mean() + 2
    assert live.min() > sensor + 2


@pytest.mark.parametrize("stride", [1, 10])
def test_temporal_filter_pays_on_slow_motion_and_costs_nothing_on_fast(phi: Sbhe, stride: int) -> None:
    """At 0.045 mm a cycle, the paper's speed, and ten times as fast; a cylinder's edge is the hardest to follow."""
    place = (np.arange(64) - 31.5) * 0.004
    steps = np.arange(0, 400 * stride, stride)

    def pressed(step: int) -> np.ndarray:
        inside = (place[None, :] - 0.03 + 2e-5 * step) ** 2 + (place[:, None] - 0.06 + 4e-5 * step) ** 2 < 0.03**2
        return np.where(inside, 0.01, 0.0)

    scene = sense(phi, np.stack([np.zeros((64, 64))] * 10 + [pressed(int(step)) for step in steps[: 3000 // stride]]))
    plain, filtered, paper = (
        psnr_db(images(phi, scene, settings), scene.true)[20:].mean() for settings in (VARIATION, LIVE, PAPER)
    )
    assert filtered > plain + (0.7 if stride == 1 else 0.1)
    assert filtered > paper + (4.5 if stride == 1 else 3.5)


def test_options_are_checked() -> None:
    with pytest.raises(InputError, match="unknown solver 'best': expected one of live, variation"):
        preset("best")


@pytest.mark.parametrize("settings", [LIVE, VARIATION, SPUN, PAPER, PAPER_CONTOURLET])
def test_never_negative_and_float32(phi: Sbhe, golf: Scene, settings: SolverSettings) -> None:
    made = images(phi, golf, settings)
    assert made.dtype == np.float32
    assert made.min() >= 0
    assert made.max() < 0.02
    assert made.max() > 0.008


@pytest.mark.parametrize("settings", [LIVE, VARIATION, SPUN])
@pytest.mark.parametrize("iterations", [5, 20])
def test_warm_start_is_no_worse_than_a_cold_one_when_all_changes_at_once(
    phi: Sbhe, settings: SolverSettings, iterations: int
) -> None:
    """Another touch in every cycle, after a skin that was not touched."""
    rng = np.random.default_rng(2)
    idle = [np.zeros((64, 64))] * 20
    jumps = sense(phi, np.stack(idle + [ball(*rng.uniform(-0.1, 0.1, 2), 0.01) for _ in range(60)]))
    settings = replace(settings, iterations=iterations)
    warm, cold = (psnr_db(images(phi, jumps, settings, cold=each), jumps.true)[20:].mean() for each in (False, True))
    assert warm > cold - 0.2


def test_without_a_scaled_start_a_ghost_stays(phi: Sbhe) -> None:
    """Five iterations do not wipe out a touch that is gone."""
    scene = sense(phi, np.stack([ball(-0.05, 0, 0.01)] * 5 + [ball(0.05, 0, 0.01)]))
    old_place = scene.true[0] > 0.002
    scaled, plain = (
        images(phi, scene, replace(LIVE, iterations=5, scaled_start=each))[-1][old_place].mean()
        for each in (True, False)
    )
    assert scaled < 0.0007 < plain


def test_warm_start_is_better_than_a_cold_one_on_a_slow_touch(phi: Sbhe, golf: Scene) -> None:
    settings = replace(LIVE, iterations=5)
    warm, cold = (psnr_db(images(phi, golf, settings, cold=each), golf.true).mean() for each in (False, True))
    assert warm > cold + 0.2


def test_in_turns_each_measurement_is_averaged_with_the_one_before_it_in_its_turn(phi: Sbhe) -> None:
    """So a measurement that comes once in each turn gives what it gives in one instant, but for a smaller λ."""
    sums_n = (0.05 + np.random.default_rng(3).normal(0, 5e-5, (20, 1024))).astype(np.float32)
    for samples, factor in ((10, TURNS_PENALTY), (1, 1.0)):
        together = Reconstructor(phi, 64, 64, samples=samples)
        apart = Reconstructor(phi, 64, 64, samples=max(1, samples // 2), turns=2)
        for each in sums_n:
            sums, weights, penalty = together.average(each, ALL_VALID)
            for _ in range(2):
                in_turns = apart.average(each, ALL_VALID)
                np.testing.assert_array_equal(in_turns[:2], (sums, weights))
                assert in_turns[2] == pytest.approx(factor * penalty, rel=1e-12)


def test_halves_that_come_in_turns_have_the_noise_of_sums_that_come_together(phi: Sbhe) -> None:
    noise_n, quiet_n = 2e-4, np.random.default_rng(4).normal(0, 1.0, (400, 1024)).astype(np.float32)
    together = Reconstructor(phi, 64, 64, samples=10)
    apart = Reconstructor(phi, 64, 64, samples=5, turns=2)
    newest_n, half = np.zeros(1024, np.float32), np.arange(1024) % 8 < 4
    for number, each in enumerate(0.05 + noise_n * quiet_n):
        newest_n[half == number % 2] = each[half == number % 2]
        expected, found = together.average(each, ALL_VALID)[2], apart.average(newest_n, ALL_VALID)[2]
    assert found == pytest.approx(TURNS_PENALTY * expected, rel=0.05)


def loudest_block(phi: Sbhe, image: np.ndarray) -> int:
    return int(image.reshape(-1)[phi.order].reshape(phi.blocks, -1).sum(axis=1).argmax())


def test_silent_block_shows_what_its_neighbours_make_likely(phi: Sbhe) -> None:
    """Its taxels follow a touch that leaves and one that comes although none of them is measured."""
    touch, nothing = ball(0, 0, 0.01), np.zeros((64, 64))
    block = loudest_block(phi, touch)
    taxels = phi.order[block * phi.block_size : (block + 1) * phi.block_size]
    valid = phi.sums_of_blocks(np.arange(phi.blocks) != block)
    scene = sense(phi, np.stack([touch] * 3 + [nothing] * 6 + [touch] * 20))
    engine = Reconstructor(phi, 64, 64)
    for sums in scene.sums[:3]:
        engine.solve(sums, ALL_VALID)
    left = np.stack([engine.solve(sums, valid).reshape(-1)[taxels] for sums in scene.sums[3:9]])
    assert left[1:].max() < 0.0015  # idle taxels read up to about as much
    back = np.stack([engine.solve(sums, valid).reshape(-1)[taxels] for sums in scene.sums[9:]]).mean(axis=0)
    felt = touch.reshape(-1)[taxels]
    pressed = felt > 0.008
    assert pressed.any()
    assert (back[pressed] > 0.4 * felt[pressed]).all()
    assert back[felt == 0].max() < 0.0015


def test_half_the_blocks_still_show_the_touch(phi: Sbhe, golf: Scene) -> None:
    valid = phi.sums_of_blocks(np.arange(phi.blocks) % 2 == 0)
    engine = Reconstructor(phi, 64, 64)
    for sums in golf.sums[:30]:
        image = engine.solve(sums, valid)
    peak = np.unravel_index(image.argmax(), image.shape)
    assert golf.true[29][peak] > 0.005


def test_no_valid_sum_gives_zeros_and_forgets(phi: Sbhe, golf: Scene) -> None:
    engine, fresh = Reconstructor(phi, 64, 64), Reconstructor(phi, 64, 64)
    engine.solve(golf.sums[30], ALL_VALID)
    assert not engine.solve(golf.sums[31], ~ALL_VALID).any()
    np.testing.assert_array_equal(engine.solve(golf.sums[32], ALL_VALID), fresh.solve(golf.sums[32], ALL_VALID))


def test_warm_up_leaves_no_trace_and_images_are_the_callers(phi: Sbhe, golf: Scene) -> None:
    warmed, fresh = Reconstructor(phi, 64, 64), Reconstructor(phi, 64, 64)
    warmed.warm_up()
    first = warmed.solve(golf.sums[30], ALL_VALID)
    kept = first.copy()
    np.testing.assert_array_equal(first, fresh.solve(golf.sums[30], ALL_VALID))
    warmed.solve(golf.sums[0], ALL_VALID)
    np.testing.assert_array_equal(first, kept)


def test_averaged_sums_have_no_bias_to_correct(phi: Sbhe) -> None:
    with pytest.raises(InputError, match=r"undo the bias of clipping themselves: .* got 0.001 N"):
        Reconstructor(phi, 64, 64, noise_n=0.001, samples=10)


def test_no_noise_is_no_correction(phi: Sbhe) -> None:
    sums, valid = np.full(1024, 0.01, np.float32), np.ones(1024, np.bool_)
    off, plain = Reconstructor(phi, 64, 64, noise_n=0.0), Reconstructor(phi, 64, 64)
    np.testing.assert_array_equal(off.solve(sums, valid), plain.solve(sums, valid))
