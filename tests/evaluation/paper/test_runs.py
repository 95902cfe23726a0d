"""Runs over a trajectory: what they measure with, and that they give the paper's numbers where it is exact."""

import numpy as np
import pytest

from evaluation.paper.runs import (
    CHUNK,
    NOISELET_PENALTY_N,
    Method,
    cell,
    felt_force,
    measure,
    phi_seed,
    rebuilt_images,
    sums_of,
    true_force,
)
from evaluation.paper.tables import measure_sensor, psnr_columns
from evaluation.printed import Matrix, Psnr, sensor_psnr
from evaluation.result import Options
from evaluation.solvers.noiselet import noiselet
from reconstructor.bases import wavelet_basis
from reconstructor.fista import fista
from reconstructor.settings import PAPER
from skin.psnr import psnr_db, psnr_series_db

GOLF = {"name": "golf-ball", "meshes": None, "seed": 0, "draw": 0}


def test_sums_are_phi_times_the_taxels_whatever_the_chunks() -> None:
    phi = noiselet(64, 64, 50)
    felt = np.random.default_rng(0).random((CHUNK + 3, 64, 64), np.float32)
    expected = phi.forward(felt.reshape(len(felt), -1).astype(np.float64))
    np.testing.assert_allclose(sums_of(phi, felt), expected, atol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("matrix", ["sbhe", "noiselet"])
def test_a_run_is_the_plain_fista_kept_from_step_to_step(matrix: Matrix) -> None:
    method = Method(matrix, 1024, "haar", 4)
    true = true_force("golf-ball", None, 700)
    phi, solver = method.make(seed=5)
    psi, s, expected = wavelet_basis("haar-tensor", 64, 64), None, []
    for image in true:
        sums_n = phi.forward(image.reshape(-1).astype(np.float64))
        penalty_n = NOISELET_PENALTY_N if matrix == "noiselet" else PAPER.penalty_n
        s = fista(phi, psi, sums_n, penalty_n=penalty_n, lipschitz=2 * phi.norm_squared, iterations=4, start=s)
        rebuilt = np.maximum(psi.adjoint(s), 0).astype(np.float32)
        expected.append(psnr_db(image, rebuilt))
    found = [psnr_db(*pair) for pair in zip(true, rebuilt_images(phi, solver, true), strict=True)]
    np.testing.assert_allclose(found[1:], expected[1:], atol=0.01)


def test_the_largest_psnr_of_an_untouched_skin_falls_with_the_drawn_rows_without_a_minus() -> None:
    """The cause of the largest PSNR in ``printed.toml``: only these rows see the mean of noise that is clipped."""
    true, method = np.zeros((100, 64, 64), np.float32), Method("sbhe", 1024, "haar", 20)
    found = []
    for draw in range(12):
        phi, solver = method.make(phi_seed(0, draw))
        images = rebuilt_images(phi, solver, felt_force(true, 0, draw))
        seen = float((phi.forward(np.ones(4096, np.float32)) ** 2).sum())
        found.append((seen, float(psnr_series_db(true, images).max())))
    assert np.corrcoef(*zip(*found, strict=True))[0, 1] < -0.5


def test_draws_differ_and_are_repeated_by_their_number() -> None:
    method = Method("sbhe", 819, "haar", 3)
    first, second = (cell("golf-ball", method, Options(), draw=draw, stride=600) for draw in (0, 1))
    assert measure(**first) == measure(**first)
    assert measure(**first) != measure(**second)
    assert len(measure(**first | {"series": True})["psnr_db"]) == 7


def test_sensor_signal_of_the_golf_ball() -> None:
    found = measure_sensor(**GOLF, stride=10)
    assert abs(found["mean"] - sensor_psnr("golf-ball").mean) < 0.1
    assert found["least"] < found["mean"] < found["most"]


def test_columns_are_means_over_draws() -> None:
    found = [{"mean": 30.0, "least": 28.0, "most": 33.0}, {"mean": 31.0, "least": 29.0, "most": 34.0}]
    assert psnr_columns(found, Psnr(30.3, 28.0, 34.0)) == {
        "ours": 30.5,
        "paper": 30.3,
        "difference": 0.2,
        "spread": 0.5,
        "least": 28.5,
        "least_spread": 0.5,
        "paper_least": 28.0,
        "most": 33.5,
        "most_spread": 0.5,
        "paper_most": 34.0,
    }
