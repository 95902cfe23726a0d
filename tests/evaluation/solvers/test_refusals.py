"""What the comparisons' solvers and operators cannot compute is refused in one line."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from evaluation.solvers.baselines import admm, smoothed_l0
from evaluation.solvers.noiselet import noiselet
from evaluation.solvers.pursuit import basis_pursuit
from reconstructor.bases import haar_tensor
from skin.measurement import sbhe
from tests.reconstructor.test_refusals import INF, NAN, one_line, spoilt

PHI = sbhe(256, 64, block_size=16, seed=3)
NOISELET = noiselet(16, 16, 64)
PSI = haar_tensor(16, 16)
SUMS = np.random.default_rng(0).normal(0, 0.02, 64)
IMAGE = np.ones((16, 16))


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda x: x[:-1], "shape"),
        (lambda x: x.reshape(-1, 1), "shape"),
        (list, "array"),
        (lambda x: x.astype(np.complex128), "complex128"),
        (lambda x: spoilt(x, NAN), "finite"),
        (lambda x: spoilt(x, -INF), "finite"),
    ],
)
def test_vectors_of_a_noiselet(spoil: Callable[[np.ndarray], Any], says: str) -> None:
    one_line(lambda: NOISELET.forward(spoil(np.ones(256))), says)
    one_line(lambda: NOISELET.adjoint(spoil(np.ones(64))), says)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: noiselet(16, 12, 9), "powers of two"),
        (lambda: noiselet(-16, -16, 9), "powers of two"),
        (lambda: noiselet(16, 16, 0), "1 to 256 sums"),
        (lambda: noiselet(16, 16, 257), "1 to 256 sums"),
        (lambda: noiselet(16, 16, 9, seed=-1), "seed"),
    ],
)
def test_sizes_of_a_noiselet(make: Callable[[], Any], says: str) -> None:
    one_line(make, says)


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"sums_n": SUMS[:-1]}, "sums: .*shape"),
        ({"sums_n": spoilt(SUMS, NAN)}, "sums: .*finite"),
        ({"start": np.zeros(256)}, "start"),
        ({"penalty_n": -0.01}, "penalty"),
        ({"iterations": 0}, "at least 1 iteration"),
        ({"coupling": 0.0}, "coupling: expected a number above 0"),
        ({"coupling": NAN}, "coupling: expected a number above 0"),
    ],
)
def test_admm(changed: dict[str, Any], says: str) -> None:
    one_line(lambda: admm(PHI, PSI, **{"sums_n": SUMS, "penalty_n": 0.01, "iterations": 3, **changed}), says)


@pytest.mark.parametrize(
    "changed",
    [{"tolerance_n": -1}, {"tolerance_n": NAN}, {"smallest_n": 0}, {"smallest_n": INF}, {"shrink": 1}, {"shrink": NAN}],
)
def test_smoothed_l0(changed: dict[str, Any]) -> None:
    options = {"tolerance_n": 0.1, "smallest_n": 0.001, **changed}
    one_line(lambda: smoothed_l0(PHI, PSI, SUMS, **options), "smoothed L0 needs")
    one_line(lambda: smoothed_l0(PHI, PSI, SUMS, tolerance_n=0.1, smallest_n=0.001, inner=0), "at least 1 iteration")
    one_line(lambda: smoothed_l0(PHI, PSI, spoilt(SUMS, NAN), tolerance_n=0.1, smallest_n=0.001), "finite")


@pytest.mark.parametrize(
    ("image", "options", "says"),
    [
        (IMAGE, {"scale": 0.0}, "scale: expected a number above 0"),
        (IMAGE, {"relative_error": NAN}, "relative error"),
        (IMAGE, {"iterations": 0}, "at least 1 iteration"),
        (spoilt(IMAGE, NAN), {}, "finite"),
    ],
)
def test_basis_pursuit(image: np.ndarray, options: dict[str, Any], says: str) -> None:
    one_line(lambda: basis_pursuit(PSI, image, **options), says)
