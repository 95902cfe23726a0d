"""Many frames at once equal one after the other."""

import numpy as np
import pytest

from reconstructor.arrays import BatchSolver, array_library
from reconstructor.bases import haar_tensor
from reconstructor.batch import reconstruct_recording
from reconstructor.fista import fista_image
from reconstructor.kernels.fused import FusedSolver
from reconstructor.kernels.lanes import LANES, LaneSolver
from reconstructor.proximal import Shrinkage
from skin.errors import InputError
from skin.measurement import Sbhe, sbhe
from tests.reconstructor.conftest import Scene, psnr_db

PHI = sbhe(512, 128, block_size=16, selection="uniform", seed=3)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_lanes_are_the_single_solver(dtype: type) -> None:
    rng = np.random.default_rng(0)
    sums = rng.normal(0, 0.03, (LANES, 128)).astype(dtype)
    weights = (rng.random((LANES, 128)) > 0.2).astype(dtype)
    options = {"iterations": 9, "penalty_n": 0.01, "spins": 3, "nonnegative": True, "dtype": dtype}
    lanes, single = LaneSolver(PHI, 16, 32, **options), FusedSolver(PHI, 16, 32, prior="haar-pyramid", **options)
    estimate = lanes.new_estimate()
    lanes.solve(estimate, np.where(weights > 0, sums, 1e6).astype(dtype), weights)
    made = lanes.deliver(estimate)
    for lane in range(LANES):
        alone = single.new_estimate()
        single.solve(alone, sums[lane], weights[lane])
        np.testing.assert_allclose(made[lane], single.deliver(alone), atol=1e-7)
    assert made.any()


@pytest.mark.parametrize("frames", [0, 1, 7, 60])
def test_recording_is_as_good_as_one_frame_after_the_other(phi: Sbhe, golf: Scene, frames: int) -> None:
    options = {"iterations": 10, "penalty_n": 0.008, "spins": 8, "nonnegative": True}
    single = FusedSolver(phi, 64, 64, prior="haar-pyramid", **options)
    valid = np.ones((frames, 1024), np.bool_)
    made = reconstruct_recording(LaneSolver(phi, 64, 64, **options), golf.sums[:frames], valid)
    assert made.shape == (frames, 64, 64)
    estimate = single.new_estimate()
    for k in range(frames):
        single.solve(estimate, golf.sums[k], np.ones(1024, np.float32))
        theirs = single.deliver(estimate)
        assert psnr_db(made[k : k + 1], golf.true[k : k + 1])[0] > psnr_db(theirs[None], golf.true[k : k + 1])[0] - 0.3
        if k < -(-frames // LANES):
            np.testing.assert_allclose(made[k], theirs, atol=1e-6)


@pytest.mark.parametrize(("dtype", "error"), [(np.float64, 1e-12), (np.float32, 1e-6)])
def test_array_solver_is_the_reference(dtype: type, error: float) -> None:
    rng = np.random.default_rng(1)
    sums, start = rng.normal(0, 0.03, (4, 128)), np.abs(rng.normal(0, 0.005, (4, 16, 32)))
    valid = np.ones((4, 128), np.bool_)
    solver = BatchSolver(PHI, 16, 32, iterations=9, penalty_n=0.01, lipschitz_ratio=2.0, dtype=dtype)
    made = solver.solve(sums.astype(dtype), valid, start)
    assert made.dtype == dtype
    for k in range(4):
        wanted = fista_image(
            PHI,
            Shrinkage(haar_tensor(16, 32)),
            sums[k],
            penalty_n=0.01,
            lipschitz=32,
            iterations=9,
            start=start[k],
        )
        np.testing.assert_allclose(made[k], np.maximum(wanted, 0), atol=error)


def test_array_solver_leaves_sums_out_exactly() -> None:
    rng = np.random.default_rng(2)
    sums, valid = rng.normal(0, 0.03, (3, 128)), rng.random((3, 128)) > 0.3
    options = {"iterations": 9, "penalty_n": 0.01, "nonnegative": True, "dtype": np.float64}
    single = FusedSolver(PHI, 16, 32, prior="haar-tensor", **options)
    made = BatchSolver(PHI, 16, 32, **options).solve(np.where(valid, sums, np.nan), valid)
    for k in range(3):
        estimate = single.new_estimate()
        single.solve(estimate, sums[k], valid[k].astype(np.float64))
        np.testing.assert_allclose(made[k], single.deliver(estimate), atol=1e-8)


def test_wrong_batches_are_refused(phi: Sbhe) -> None:
    solver = LaneSolver(phi, 64, 64, iterations=1, penalty_n=0.01)
    arrays = BatchSolver(phi, 64, 64, iterations=1, penalty_n=0.01)
    sums, valid = np.zeros((3, 1024)), np.ones((3, 1024), np.bool_)
    for solve in (lambda *args: reconstruct_recording(solver, *args), arrays.solve):
        with pytest.raises(InputError, match=r"\(frames, 1024\)"):
            solve(sums[:, :5], valid)
        with pytest.raises(InputError, match="not finite"):
            solve(sums + np.inf, valid)
    with pytest.raises(InputError, match="expected numpy or cupy"):
        array_library("torch")
    assert array_library("numpy") is np
