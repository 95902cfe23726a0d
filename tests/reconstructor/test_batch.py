"""Many frames at once equal one after the other."""

import sys
from types import SimpleNamespace

import array_api_strict
import numpy as np
import pytest

from reconstructor.arrays import BatchSolver, array_library
from reconstructor.bases import haar_tensor
from reconstructor.batch import reconstruct_recording
from reconstructor.fista import fista_image
from reconstructor.kernels.contourlet import ContourletSolver
from reconstructor.kernels.fused import FusedSolver
from reconstructor.kernels.lanes import LANES, LaneSolver
from reconstructor.kernels.problem import Prior
from reconstructor.proximal import Shrinkage
from skin.errors import InputError
from skin.measurement import Sbhe, sbhe
from tests.reconstructor.conftest import Scene, psnr_db

PHI = sbhe(512, 128, block_size=16, selection="uniform", seed=3)


@pytest.mark.parametrize("prior", ["haar-pyramid", "haar-tensor", "d4-pyramid", "d4-tensor"])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_lanes_are_the_single_solver(prior: Prior, dtype: type) -> None:
    rng = np.random.default_rng(0)
    sums = rng.normal(0, 0.03, (LANES, 128)).astype(dtype)
    weights = (rng.random((LANES, 128)) > 0.2).astype(dtype)
    options = {"prior": prior, "iterations": 9, "penalty_n": 0.01, "spins": 3, "nonnegative": True, "dtype": dtype}
    lanes, single = LaneSolver(PHI, 16, 32, **options), FusedSolver(PHI, 16, 32, **options)
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


@pytest.mark.parametrize("kind", ["variation", "contourlet"])
def test_recordings_without_lanes_are_one_frame_after_the_other(phi: Sbhe, golf: Scene, kind: str) -> None:
    """Also a second time: nothing of the first recording is left."""
    valid = np.random.default_rng(0).random((5, 1024)) > 0.1
    options = {"iterations": 5, "penalty_n": 0.006}
    solver, single = (
        ContourletSolver(phi, 64, 64, **options)
        if kind == "contourlet"
        else FusedSolver(phi, 64, 64, prior="variation", **options)
        for _ in range(2)
    )
    spoilt = np.where(valid, golf.sums[:5], np.nan).astype(np.float64)
    made = [reconstruct_recording(solver, spoilt, valid) for _ in range(2)]
    estimate = single.new_estimate()
    for k in range(5):
        single.solve(estimate, golf.sums[k], valid[k].astype(np.float32))
        np.testing.assert_array_equal(made[0][k], single.deliver(estimate))
    np.testing.assert_array_equal(made[1], made[0])
    assert reconstruct_recording(solver, spoilt[:0], valid[:0]).shape == (0, 64, 64)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_array_solver_asks_for_nothing_beyond_the_array_standard(dtype: type) -> None:
    """What runs on the library that allows the standard alone runs on CuPy too."""
    rng = np.random.default_rng(3)
    sums, valid, start = rng.normal(0, 0.03, (4, 128)), rng.random((4, 128)) > 0.3, np.ones((4, 16, 32))
    options = {"iterations": 9, "penalty_n": 0.01, "nonnegative": True, "dtype": dtype}
    made = BatchSolver(PHI, 16, 32, library=array_api_strict, **options).solve(
        *(array_api_strict.asarray(x) for x in (sums, valid, start))
    )
    wanted = BatchSolver(PHI, 16, 32, **options).solve(sums, valid, start)
    assert made.dtype == getattr(array_api_strict, np.dtype(dtype).name)
    np.testing.assert_array_equal(np.asarray(made), wanted)


def test_array_libraries_by_name(monkeypatch: pytest.MonkeyPatch) -> None:
    assert array_library("numpy") is np
    with pytest.raises(InputError, match="expected numpy or cupy"):
        array_library("torch")
    monkeypatch.setitem(sys.modules, "cupy", None)  # as if it were not installed
    with pytest.raises(InputError, match=r"CuPy cannot be loaded \(.*\): install canskin\[gpu\]$"):
        array_library("cupy")

    def no_driver() -> int:
        raise RuntimeError("driver too old")

    runtime = SimpleNamespace(getDeviceCount=no_driver, CUDARuntimeError=RuntimeError)
    monkeypatch.setitem(sys.modules, "cupy", SimpleNamespace(cuda=SimpleNamespace(runtime=runtime)))
    with pytest.raises(InputError, match="CuPy finds no GPU: driver too old"):
        array_library("cupy")
