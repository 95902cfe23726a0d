"""Many frames at once equal one after the other."""

import sys
from dataclasses import replace
from types import ModuleType, SimpleNamespace

import array_api_strict
import numpy as np
import pytest

from canskin.errors import InputError
from reconstructor.array_api import BatchSolver, gpu_library
from reconstructor.bases import haar_tensor
from reconstructor.batch import RecordingSolver
from reconstructor.engine import Reconstructor
from reconstructor.kernels.fused import FusedSolver
from reconstructor.kernels.lanes import LANES, LaneSolver
from reconstructor.settings import LIVE, PAPER, PAPER_CONTOURLET, SPUN, VARIATION, SolverSettings
from skin.measurement import Sbhe, sbhe
from tests.reconstructor.conftest import Scene, psnr_db
from tests.reconstructor.reference import Shrinkage, fista_image

PHI = sbhe(512, 128, block_size=16, selection="uniform", seed=3)


@pytest.mark.parametrize("prior", ["haar-pyramid", "haar-tensor", "d4-pyramid", "d4-tensor"])
@pytest.mark.parametrize("scaled_start", [False, True])
def test_lanes_are_the_single_solver(prior: str, scaled_start: bool) -> None:
    """Twice, so that the second solve starts from the first."""
    rng = np.random.default_rng(0)
    sums = rng.normal(0, 0.03, (LANES, 128)).astype(np.float32)
    weights = (rng.random((LANES, 128)) > 0.2).astype(np.float32)
    settings = SolverSettings(
        prior=prior, iterations=9, penalty_n=0.01, spins=3, nonnegative=True, scaled_start=scaled_start
    )
    lanes, single = (make(PHI, 16, 32, settings) for make in (LaneSolver, FusedSolver))
    estimate = lanes.new_estimate()
    for factor in (1, 0.3):
        lanes.solve(estimate, np.where(weights > 0, factor * sums, 1e6).astype(np.float32), weights)
    made = lanes.deliver(estimate)
    for lane in range(LANES):
        alone = single.new_estimate()
        for factor in (1, 0.3):
            single.solve(alone, (factor * sums[lane]).astype(np.float32), weights[lane])
        np.testing.assert_allclose(made[lane], single.deliver(alone), atol=1e-7)
    assert made.any()


def one_by_one(phi: Sbhe, settings: SolverSettings, sums: np.ndarray, valid: np.ndarray) -> np.ndarray:
    engine = Reconstructor(phi, 64, 64, settings)
    return np.stack([engine.solve(each, told) for each, told in zip(sums, valid, strict=True)])


@pytest.mark.parametrize("cycles", [1, 7, 60])
@pytest.mark.parametrize("settings", [SPUN, PAPER])
def test_recordings_in_lanes_are_as_good_as_one_cycle_after_the_other(
    phi: Sbhe, golf: Scene, settings: SolverSettings, cycles: int
) -> None:
    valid = phi.sums_of_blocks(np.arange(128) % 16 > 0) & np.ones((cycles, 1), np.bool_)
    valid[-1] = False
    done: list[int] = []
    solver = RecordingSolver(phi, 64, 64, settings)
    assert solver.method == "8 parts of the recording side by side"
    made = solver.solve(golf.sums[:cycles], valid, done.append)
    assert made.shape == (cycles, 64, 64)
    assert sum(done) == cycles
    theirs = one_by_one(phi, settings, golf.sums[:cycles], valid)
    assert not made[-1].any()  # nothing came
    true = golf.true[: cycles - 1]
    assert (psnr_db(made[:-1], true) > psnr_db(theirs[:-1], true) - 0.3).all()
    first = -(-cycles // LANES)
    np.testing.assert_allclose(made[:first], theirs[:first], atol=1e-6)


@pytest.mark.parametrize(
    "settings",
    [
        LIVE,
        VARIATION,
        replace(PAPER_CONTOURLET, iterations=5),
        replace(LIVE, prior="haar-tensor"),
        replace(SPUN, prior="sym4-pyramid", iterations=5),
    ],
)
def test_other_recordings_are_those_of_the_live_engine_bit_by_bit(
    phi: Sbhe, golf: Scene, settings: SolverSettings
) -> None:
    """Also a second time: nothing of the first recording is left."""
    valid = np.random.default_rng(0).random((9, 1024)) > 0.1
    spoilt = np.where(valid, golf.sums[:9], np.nan).astype(np.float64)
    solver = RecordingSolver(phi, 64, 64, settings)
    assert solver.method == "one image after the other"
    wanted = one_by_one(phi, settings, golf.sums[:9], valid)
    for _ in range(2):
        np.testing.assert_array_equal(solver.solve(spoilt, valid), wanted)
    assert solver.solve(spoilt[:0], valid[:0]).shape == (0, 64, 64)


def test_the_bias_of_clipping_is_corrected_as_in_the_live_engine(phi: Sbhe, golf: Scene) -> None:
    valid = np.ones((5, 1024), np.bool_)
    engine = Reconstructor(phi, 64, 64, noise_n=0.001)
    wanted = np.stack([engine.solve(each, valid[0]) for each in golf.sums[:5]])
    made = RecordingSolver(phi, 64, 64, noise_n=0.001).solve(golf.sums[:5], valid)
    np.testing.assert_array_equal(made, wanted)


@pytest.mark.heavy
@pytest.mark.parametrize("library", [np, array_api_strict])
def test_recordings_on_arrays_are_as_good_as_one_cycle_after_the_other(
    phi: Sbhe, golf: Scene, library: ModuleType
) -> None:
    """Two streams of 50 cycles: 60 and back again."""
    sums, true = (np.concatenate((each, each[::-1][:40])) for each in (golf.sums, golf.true))
    valid = np.random.default_rng(0).random((100, 1024)) > 0.1
    valid[70] = False
    solver = RecordingSolver(phi, 64, 64, PAPER, library=library)
    assert library.__name__ in solver.method
    made, theirs = solver.solve(sums, valid), one_by_one(phi, PAPER, sums, valid)
    assert made.dtype == np.float32
    assert not made[70].any()
    assert (psnr_db(made, true) > psnr_db(theirs, true) - 0.3).all()
    np.testing.assert_allclose(made[:50], theirs[:50], atol=1e-5)


@pytest.mark.parametrize(("dtype", "error"), [(np.float64, 1e-12), (np.float32, 1e-6)])
def test_array_solver_is_the_reference(dtype: type, error: float) -> None:
    rng = np.random.default_rng(1)
    sums, start = rng.normal(0, 0.03, (4, 128)), np.abs(rng.normal(0, 0.005, (4, 16, 32)))
    valid = np.ones((4, 128), np.bool_)
    solver = BatchSolver(PHI, 16, 32, replace(PAPER, iterations=9), dtype=dtype)
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
        np.testing.assert_allclose(made[k], wanted, atol=error)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_array_solver_asks_for_nothing_beyond_the_array_standard(dtype: type) -> None:
    """What runs on the library that allows the standard alone runs on CuPy too."""
    rng = np.random.default_rng(3)
    sums, valid, start = rng.normal(0, 0.03, (4, 128)), rng.random((4, 128)) > 0.3, np.ones((4, 16, 32))
    settings = replace(PAPER, iterations=9, nonnegative=True)
    strict = BatchSolver(PHI, 16, 32, settings, library=array_api_strict, dtype=dtype)
    made = strict.solve(*(array_api_strict.asarray(x) for x in (sums, valid, start)))
    plain = BatchSolver(PHI, 16, 32, settings, dtype=dtype)
    wanted = plain.solve(np.where(valid, sums, np.nan), valid, start)
    assert made.dtype == getattr(array_api_strict, np.dtype(dtype).name)
    np.testing.assert_array_equal(np.asarray(made), wanted)
    np.testing.assert_array_equal(strict.deliver(made), plain.deliver(wanted))


def test_without_a_gpu_one_line_says_what_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cupy", None)  # as if it were not installed
    with pytest.raises(
        InputError, match=r'CuPy cannot be loaded \(.*\): in a clone of canskin, pip install ./client "\.\[gpu\]"$'
    ):
        gpu_library()

    def no_driver() -> int:
        raise RuntimeError("driver too old")

    runtime = SimpleNamespace(getDeviceCount=no_driver, CUDARuntimeError=RuntimeError)
    monkeypatch.setitem(sys.modules, "cupy", SimpleNamespace(cuda=SimpleNamespace(runtime=runtime)))
    with pytest.raises(InputError, match="CuPy finds no GPU: driver too old"):
        gpu_library()
