"""The solver on arrays: many cycles at once equal one after the other."""

import sys
from dataclasses import replace
from types import ModuleType, SimpleNamespace

import array_api_strict
import numpy as np
import pytest

from canskin.errors import InputError
from reconstructor.array_api import BatchSolver, gpu_library
from reconstructor.bases import wavelet_basis
from reconstructor.engine import Reconstructor
from reconstructor.settings import PAPER, SolverSettings
from skin.measurement import Sbhe, sbhe
from tests.reconstructor.helpers import Scene, psnr_db
from tests.reconstructor.reference import Shrinkage, fista_image

PHI = sbhe(512, 128, block_size=16, selection="uniform", seed=3)


def one_by_one(phi: Sbhe, settings: SolverSettings, sums: np.ndarray, valid: np.ndarray) -> np.ndarray:
    engine = Reconstructor(phi, 64, 64, settings)
    return np.stack([engine.solve(each, told) for each, told in zip(sums, valid, strict=True)])


@pytest.mark.heavy
@pytest.mark.parametrize("library", [np, array_api_strict])
def test_recordings_on_arrays_are_as_good_as_one_cycle_after_the_other(
    phi: Sbhe, golf: Scene, library: ModuleType
) -> None:
    """Two streams of 50 cycles: 60 and back again."""
    sums, true = (np.concatenate((each, each[::-1][:40])) for each in (golf.sums, golf.true))
    valid = np.random.default_rng(0).random((100, 1024)) > 0.1
    valid[70] = False
    done: list[int] = []
    made = BatchSolver(phi, 64, 64, PAPER, library=library).solve_recording(sums, valid, done.append)
    theirs = one_by_one(phi, PAPER, sums, valid)
    assert sum(done) == 100
    assert made.dtype == np.float32
    assert not made[70].any()
    assert (psnr_db(made, true) > psnr_db(theirs, true) - 0.3).all()
    np.testing.assert_allclose(made[:50], theirs[:50], atol=1e-5)


def test_the_bias_of_clipping_is_corrected_as_in_the_live_engine() -> None:
    sums, valid = np.random.default_rng(1).normal(0.02, 0.03, (1, 128)).astype(np.float32), np.ones((1, 128), np.bool_)
    engine = Reconstructor(PHI, 16, 32, PAPER, noise_n=0.001)
    made = BatchSolver(PHI, 16, 32, PAPER, noise_n=0.001).solve_recording(sums, valid, lambda _: None)
    np.testing.assert_allclose(made[0], engine.solve(sums[0], valid[0]), atol=1e-6)


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
            Shrinkage(wavelet_basis("haar-tensor", 16, 32)),
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
