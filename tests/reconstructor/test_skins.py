"""Several skins on one pool of threads: the same images as alone, and really side by side."""

import threading

import numpy as np
import pytest

from reconstructor.engine import Reconstructor
from reconstructor.kernels.fused import FusedSolver
from reconstructor.skins import Cycle, SkinPool
from skin.errors import InputError
from skin.measurement import Sbhe, sbhe

#: Skins of different sizes, block sizes and rows.
SKINS: dict[str, tuple[Sbhe, tuple[int, int]]] = {
    "palm": (sbhe(1024, 256, seed=1), (32, 32)),
    "finger": (sbhe(128, 64, block_size=16, seed=2), (16, 8)),
    "thumb": (sbhe(128, 64, block_size=16, seed=3), (16, 8)),
    "arm": (sbhe(2048, 512, block_size=64, selection="uniform", seed=4), (32, 64)),
    "back": (sbhe(4096, 512, seed=5), (64, 64)),
}


def engines() -> dict[str, Reconstructor]:
    return {name: Reconstructor(phi, *grid) for name, (phi, grid) in SKINS.items()}


def cycle_of(name: str, number: int) -> Cycle:
    """A smooth bump of 10 mN that wanders, a tenth of the sums missing."""
    phi, (rows, columns) = SKINS[name]
    random = np.random.default_rng(number)
    i, j = np.indices((rows, columns))
    bump = 0.01 * np.exp(-((i - rows / 2 - number / 5) ** 2 + (j - columns / 2) ** 2) / 8)
    felt = np.maximum(bump + random.normal(0, 0.001, bump.shape), 0).reshape(-1)
    return Cycle(np.asarray(phi.forward(felt), np.float32), random.random(phi.shape[0]) > 0.1)


@pytest.mark.parametrize("threads", [1, 2, 3, 9])
def test_images_are_those_of_each_skin_alone(threads: int) -> None:
    alone = engines()
    with SkinPool(engines(), threads) as pool:
        for number in range(6):
            cycles = {name: cycle_of(name, number) for name in SKINS if (number + len(name)) % 4}  # some stay silent
            images = pool.solve(cycles)
            assert list(images) == list(cycles)
            for name, cycle in cycles.items():
                np.testing.assert_array_equal(images[name], alone[name].solve(*cycle))
        assert images["palm"].shape == (32, 32)
        assert images["palm"].max() > 0.004
        assert pool.solve({}) == {}


def test_the_interpreter_is_free_while_a_kernel_runs() -> None:
    """Another thread gets to run between begin and end of one call, many times over."""
    phi, grid = SKINS["arm"]
    solver = FusedSolver(phi, *grid, prior="variation", iterations=20_000, penalty_n=0.01)
    estimate, sums, weights = solver.new_estimate(), cycle_of("arm", 0).sums_n, np.ones(512, np.float32)
    FusedSolver(phi, *grid, prior="variation", iterations=1, penalty_n=0.01).solve(estimate, sums, weights)  # compiles
    inside = threading.Event()
    turns = 0

    def solve() -> None:
        inside.set()
        solver.solve(estimate, sums, weights)

    thread = threading.Thread(target=solve)
    thread.start()
    inside.wait()
    while thread.is_alive():
        turns += 1
        thread.join(0.001)
    assert turns > 20


def test_what_is_refused_names_the_skin_and_stops_no_other() -> None:
    alone, cycle = engines(), cycle_of("finger", 0)
    with SkinPool(engines(), 2) as pool:
        spoilt = Cycle(np.full(256, np.nan, np.float32), np.ones(256, np.bool_))
        with pytest.raises(InputError, match="skin 'palm': a valid sum is not finite"):
            pool.solve({"palm": spoilt, "finger": cycle, "thumb": cycle_of("thumb", 0)})
        alone["finger"].solve(*cycle)
        again = cycle_of("finger", 1)
        np.testing.assert_array_equal(pool.solve({"finger": again})["finger"], alone["finger"].solve(*again))
        with pytest.raises(InputError, match="unknown skin 'toe': expected one of palm, finger"):
            pool.solve({"toe": cycle})


def test_pools_that_cannot_be() -> None:
    one = engines()["finger"]
    with pytest.raises(InputError, match="one reconstructor of its own"):
        SkinPool({"a": one, "b": one}, 2)
    with pytest.raises(InputError, match="one skin at least"):
        SkinPool({}, 2)
    with pytest.raises(InputError, match="at least 1 thread, got 0"):
        SkinPool({"a": one}, 0)
