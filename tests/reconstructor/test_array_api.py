"""The solver on arrays: many streams at once equal the compiled solver, one after the other."""

import sys
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import array_api_strict
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canskin.errors import InputError
from reconstructor.array_api import NUMPY, ArrayLibrary, BatchSolver, array_library
from reconstructor.bases import wavelet_basis
from reconstructor.engine import Reconstructor, make_solver
from reconstructor.kernels.addresses import spin_shifts
from reconstructor.settings import LIVE, PAPER, SPUN, VARIATION, SolverSettings
from skin.phi import Sbhe, sbhe
from tests.reconstructor.helpers import Scene, graphs
from tests.reconstructor.reference import Shrinkage, fista_image

#: Allows the array standard alone: what runs on it runs on CuPy, too.
STRICT = ArrayLibrary(array_api_strict, "array-api-strict")
PHI = sbhe(512, 128, block_size=16, selection="uniform", seed=3)


LIBRARIES = {"numpy": NUMPY, "strict": STRICT}


@pytest.fixture(params=[*LIBRARIES, ("cpu", "torch"), ("gpu", "torch"), ("gpu", "cupy")], ids=str)
def library(request: pytest.FixtureRequest) -> ArrayLibrary:
    if request.param in LIBRARIES:
        return LIBRARIES[request.param]
    try:
        return array_library(*request.param)
    except InputError as missing:
        pytest.skip(f"NOT TESTED: {missing}")


@st.composite
def skins(draw: st.DrawFn) -> dict[str, Any]:
    """Draw a skin, full, with gaps, with empty places or at positions, and a solver that can solve it."""
    prior = draw(st.sampled_from(["variation", "haar-tensor", "haar-pyramid"]))
    seed, rng = draw(st.integers(0, 2**31)), np.random.default_rng(draw(st.integers(0, 2**31)))
    gaps, edges = np.zeros(0, np.intp), None
    if prior == "variation":
        rows, columns = draw(st.sampled_from([(8, 16), (5, 7), (12, 20), (1, 9), (30, 1)]))
        gaps = np.flatnonzero(rng.random(rows * columns) < draw(st.sampled_from([0.0, 0.3])))[: rows * columns - 2]
        edges = draw(st.none() | graphs(rows * columns)) if not gaps.size else None
    else:
        rows, columns = draw(st.sampled_from([(8, 8), (16, 8), (8, 32)]))
    size = 2 ** draw(st.integers(1, 3))
    blocks = -(-(rows * columns - gaps.size) // size)
    sums = blocks * draw(st.integers(1, size))
    return {
        "phi": sbhe(rows * columns, sums, block_size=size, gaps=gaps, seed=seed),
        "grid": (rows, columns),
        "edges": edges,
        "settings": SolverSettings(
            prior=prior,
            iterations=draw(st.integers(1, 6)),
            penalty_n=0.01,
            lipschitz_ratio=draw(st.sampled_from([1.0, 2.0])),
            spins=draw(st.sampled_from([1, 5])) if prior != "variation" else 1,
            nonnegative=draw(st.booleans()),
            scaled_start=draw(st.booleans()),
        ),
        "seed": seed,
    }


def assert_equals_the_compiled_solver(skin: dict[str, Any], library: ArrayLibrary, dtype: type, error_n: float) -> None:
    """Three streams over four cycles, sums lost, weighted and with λ of each; the third loses all in the last cycle."""
    rng, phi, grid = np.random.default_rng(skin["seed"]), skin["phi"], skin["grid"]
    options = {"edges": skin["edges"], "dtype": dtype}
    batch = BatchSolver(phi, *grid, skin["settings"], library=library, **options).of_streams(3)
    alone: list[Any] = [make_solver(phi, *grid, skin["settings"], **options) for _ in range(3)]
    made, wanted = batch.new_estimate(), [solver.new_estimate() for solver in alone]
    for cycle in range(4):
        sums = rng.normal(0.03, 0.03, (3, phi.shape[0])).astype(dtype)
        weights = (rng.random(sums.shape) * (rng.random(sums.shape) > 0.2)).astype(dtype)
        weights[2] *= cycle < 3
        sums[weights == 0] = np.nan
        penalties = rng.uniform(0.1, 3, 3)
        assert batch.solve(made, sums, weights, relative_penalty=penalties) == np.count_nonzero(weights)
        for k, (solver, estimate) in enumerate(zip(alone, wanted, strict=True)):
            if weights[k].any():
                solver.solve(estimate, sums[k], weights[k], relative_penalty=float(penalties[k]))
            else:
                estimate[:] = 0
        images = np.stack([solver.image_of(each) for solver, each in zip(alone, wanted, strict=True)])
        np.testing.assert_allclose(library.fetch(made), images, atol=error_n)
        np.testing.assert_allclose(batch.deliver(made), np.maximum(images, 0), atol=max(error_n, 1e-8))
    assert library.fetch(made).dtype == dtype


@given(skins(), st.sampled_from(["numpy", "strict"]))
@settings(max_examples=40, deadline=None)
def test_equals_the_compiled_solver_on_any_layout(skin: dict[str, Any], library: str) -> None:
    assert_equals_the_compiled_solver(skin, LIBRARIES[library], np.float64, 1e-14)


@pytest.mark.parametrize("solver", [VARIATION, SPUN, PAPER])
def test_every_solver_on_every_library(library: ArrayLibrary, solver: SolverSettings) -> None:
    skin = {"phi": PHI, "grid": (16, 32), "edges": None, "settings": replace(solver, iterations=5), "seed": 1}
    assert_equals_the_compiled_solver(skin, library, np.float64, 1e-14)
    assert_equals_the_compiled_solver(skin, library, np.float32, 3e-7)


def test_gaps_on_every_library(library: ArrayLibrary) -> None:
    phi = sbhe(221, 100, block_size=8, gaps=np.arange(40, 67), seed=2)
    skin = {"phi": phi, "grid": (13, 17), "edges": None, "settings": VARIATION, "seed": 1}
    assert_equals_the_compiled_solver(skin, library, np.float64, 1e-14)


@pytest.mark.parametrize("prior", ["d4-pyramid", "coif1-tensor", "sym4-pyramid"])
def test_wavelets_without_a_compiled_solver_equal_the_plain_iteration(library: ArrayLibrary, prior: str) -> None:
    solver = replace(SPUN, prior=prior, iterations=7, spins=5, scaled_start=False)
    batch, sums = BatchSolver(PHI, 16, 32, solver, library=library, dtype=np.float64), np.full(128, 0.02)
    sums += np.random.default_rng(1).normal(0, 0.03, 128)
    estimate = batch.new_estimate()
    batch.solve(estimate, sums, np.ones_like(sums))
    expected = fista_image(
        PHI,
        Shrinkage(wavelet_basis(prior, 16, 32), spin_shifts(5, 16, 32), nonnegative=True),
        sums,
        penalty_n=solver.penalty_n,
        lipschitz=PHI.norm_squared,
        iterations=7,
        start=np.zeros((16, 32)),
    )
    assert expected.any()
    np.testing.assert_allclose(library.fetch(estimate)[0], expected, atol=1e-13)


@pytest.mark.parametrize("solver", [LIVE, PAPER])
def test_a_live_stream_on_arrays_is_that_of_the_compiled_solver(phi: Sbhe, golf: Scene, solver: SolverSettings) -> None:
    """Sums get lost, in one cycle all, and the bias of clipping is corrected."""
    valid = np.random.default_rng(0).random((12, 1024)) > 0.1
    valid[8] = False
    made, wanted = (
        np.stack([engine.solve(*each) for each in zip(golf.sums[20:32], valid, strict=True)])
        for engine in (Reconstructor(phi, 64, 64, solver, noise_n=0.001, library=each) for each in (NUMPY, None))
    )
    assert not made[8].any()
    np.testing.assert_allclose(made, wanted, atol=2e-6)


def test_libraries_and_devices(monkeypatch: pytest.MonkeyPatch) -> None:
    assert array_library("cpu") is NUMPY
    with pytest.raises(InputError, match="CuPy computes on a GPU"):
        array_library("cpu", "cupy")
    with pytest.raises(InputError, match="NumPy computes on a CPU"):
        array_library("gpu", "numpy")
    for name in ("cupy", "torch"):  # as if they were not installed
        monkeypatch.setitem(sys.modules, name, None)
    missing = r'CuPy cannot be loaded \(.*\): in a clone of canskin, pip install ./client "\.\[gpu\]"'
    with pytest.raises(InputError, match=r'PyTorch cannot be loaded .*"\.\[torch\]"; ' + missing + "$"):
        array_library("gpu")
    with pytest.raises(InputError, match=missing + "$"):
        array_library("gpu", "cupy")

    def no_driver() -> int:
        raise RuntimeError("driver too old")

    runtime = SimpleNamespace(getDeviceCount=no_driver, CUDARuntimeError=RuntimeError)
    monkeypatch.setitem(sys.modules, "cupy", SimpleNamespace(cuda=SimpleNamespace(runtime=runtime)))
    with pytest.raises(InputError, match=r"CuPy finds no GPU: driver too old$"):
        array_library("gpu", "cupy")
    cuda = SimpleNamespace(is_available=lambda: False)
    monkeypatch.setitem(sys.modules, "torch", SimpleNamespace(cuda=cuda, __version__="3"))
    monkeypatch.setitem(sys.modules, "array_api_compat.torch", SimpleNamespace())
    with pytest.raises(InputError, match=r"PyTorch 3 finds no GPU; CuPy finds no GPU: driver too old$"):
        array_library("gpu")
