"""The bias of clipped noise, and that its correction neither invents nor takes away a light touch."""

import numpy as np
import pytest

from canskin.errors import InputError
from reconstructor.engine import Reconstructor
from skin.clipping import ClipCorrection, clipped_mean
from skin.phi import Sbhe
from tests.reconstructor.helpers import NOISE_N, Scene, psnr_db, sense

ALL_VALID = np.ones(1024, np.bool_)


def mean_n(force_n: np.ndarray) -> np.ndarray:
    return NOISE_N * clipped_mean(force_n / NOISE_N)


def test_mean_of_a_clipped_taxel_is_what_many_samples_give() -> None:
    force = np.array([0.0, 0.0003, 0.001, 0.003, 0.01])
    samples = np.maximum(0, force + np.random.default_rng(0).normal(0, NOISE_N, (400_000, 5)))
    np.testing.assert_allclose(mean_n(force), samples.mean(axis=0), atol=6e-6)
    assert mean_n(np.zeros(1)) == pytest.approx(NOISE_N / np.sqrt(2 * np.pi))


def test_correction_is_the_inverse_and_never_negative() -> None:
    correct = ClipCorrection(NOISE_N)
    force = np.linspace(0, 0.02, 1000)
    np.testing.assert_allclose(correct(mean_n(force).astype(np.float32)), force, atol=2e-6)
    assert not correct(np.linspace(0, 0.00039, 20, dtype=np.float32)).any()


@pytest.mark.parametrize("noise_n", [0.0, -1.0, float("nan"), float("inf")])
def test_noise_must_be_a_number_above_0(noise_n: float) -> None:
    with pytest.raises(InputError, match="above 0"):
        ClipCorrection(noise_n)


def error_n(phi: Sbhe, scene: Scene, noise_n: float | None) -> np.ndarray:
    engine = Reconstructor(phi, 64, 64, noise_n=noise_n)
    made = np.stack([engine.solve(sums, ALL_VALID) for sums in scene.sums])
    return made[20:] - scene.true[20:]


@pytest.mark.parametrize("force_n", [0.0002, 0.0005, 0.001])
def test_light_distributed_contact_is_not_harmed(phi: Sbhe, force_n: float) -> None:
    """A cloth over a third of the skin, not heavier than one taxel's noise: the image as a whole comes closer to the
    truth, and the cloth itself no farther from it than a quarter more."""
    true = np.zeros((60, 64, 64))
    true[:, 10:50, 12:46] = force_n
    scene = sense(phi, true)
    covered = true[20:] > 0
    plain, corrected = (error_n(phi, scene, noise_n) for noise_n in (None, NOISE_N))
    assert np.sqrt(np.mean(corrected**2)) < 0.8 * np.sqrt(np.mean(plain**2))
    assert np.sqrt(np.mean(corrected[covered] ** 2)) < 1.25 * np.sqrt(np.mean(plain[covered] ** 2))
    assert abs(corrected[covered].mean()) < 0.2 * force_n


def test_golf_ball_gains_much(phi: Sbhe, golf: Scene) -> None:
    plain, corrected = (
        10 * np.log10(0.02**2 / np.mean(error_n(phi, golf, noise_n) ** 2)) for noise_n in (None, NOISE_N)
    )
    assert corrected > plain + 4
    assert plain < psnr_db(np.full((1, 64, 64), NOISE_N / np.sqrt(2 * np.pi)), np.zeros((1, 64, 64)))[0]
