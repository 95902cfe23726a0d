"""The other ways to solve `evaluation.bench.problem.Problem`: the paper's dense FISTA and the libraries installed.

Each gets the same A, y, start, λ, L and number of iterations, in the form it is meant to be used. Coordinate descent
gets as many sweeps as bring it to a gap no larger than ours.
"""

import warnings
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from itertools import chain
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pywt

from evaluation.bench.problem import Method, Problem
from reconstructor.checks import Values
from reconstructor.fista import momentum, soft

#: Most sweeps of coordinate descent that are tried.
SWEEPS: Final = 40


def peers(problem: Problem, dtype: npt.DTypeLike) -> list[Method]:
    """Return the paper's method and every peer that is installed, for one dtype."""
    data = _Data(problem, np.dtype(dtype))
    libraries = [make(data) for module, make in _LIBRARIES.items() if find_spec(module) is not None]
    return [*dense(problem, dtype), *chain.from_iterable(libraries)]


def dense(problem: Problem, dtype: npt.DTypeLike) -> list[Method]:
    """Return the paper's method alone, with its L and with half of it."""
    data = _Data(problem, np.dtype(dtype))
    return [
        Method("NumPy dense, L doubled (paper)", data.kind.name, lambda: _dense(data, 2.0), np.asarray),
        Method("NumPy dense", data.kind.name, lambda: _dense(data, 1.0), np.asarray),
    ]


class _Data:
    """Arrays of one dtype, contiguous as each library wants them."""

    def __init__(self, problem: Problem, kind: np.dtype[Any]) -> None:
        self.problem, self.kind = problem, kind
        self.matrix = np.ascontiguousarray(problem.matrix, kind)
        self.fortran = np.asfortranarray(self.matrix)
        self.sums, self.start = problem.sums.astype(kind), problem.start.astype(kind)
        self.step = kind.type(1 / problem.lipschitz)
        self.penalty, self.iterations = problem.penalty_n, problem.iterations

    def forward(self, s: Values) -> Values:
        """Return A s with the fast Φ and PyWavelets' Haar, as one would write it with these libraries."""
        image = pywt.waverec2(pywt.array_to_coeffs(s.reshape(64, 64), _SLICES, "wavedec2"), "haar", "periodization")
        return np.asarray(self.problem.phi.forward(image.reshape(-1)), self.kind)

    def adjoint(self, y: Values) -> Values:
        """Return Aᵀ y."""
        image = self.problem.phi.adjoint(y.reshape(-1)).reshape(64, 64)
        levels = pywt.wavedec2(image, "haar", "periodization", level=6)
        return np.asarray(pywt.coeffs_to_array(levels)[0].reshape(-1), self.kind)


_SLICES: Final = pywt.coeffs_to_array(pywt.wavedec2(np.zeros((64, 64)), "haar", "periodization", level=6))[1]


def _dense(data: _Data, ratio: float) -> Values:
    step = data.kind.type(data.step / ratio)
    threshold = data.kind.type(data.penalty * step)
    estimate = ahead = data.start
    for weight in momentum(data.iterations).astype(data.kind):
        previous = estimate
        estimate = soft(ahead - step * (data.matrix.T @ (data.matrix @ ahead - data.sums)), threshold)
        ahead = estimate + weight * (estimate - previous)
    return estimate


def _pylops(data: _Data) -> Iterator[Method]:
    import pylops
    from pylops.optimization.sparsity import fista

    operator = pylops.FunctionOperator(data.forward, data.adjoint, *data.matrix.shape, dtype=data.kind)
    for form, each in (("dense", pylops.MatrixMult(data.matrix, dtype=data.kind)), ("operator", operator)):

        def solve(each: Any = each) -> Any:
            # Its objective lacks the factor ½, so λ is doubled.
            return fista(
                each,
                data.sums,
                x0=data.start.copy(),
                niter=data.iterations,
                eps=2 * data.penalty,
                alpha=float(data.step),
                tol=0,
                show=False,
            )[0]

        yield Method(f"PyLops fista, {form}", data.kind.name, solve, np.asarray)


def _pyproximal(data: _Data) -> Iterator[Method]:
    import pylops
    import pyproximal

    operator = pylops.FunctionOperator(data.forward, data.adjoint, *data.matrix.shape, dtype=data.kind)

    def solve() -> Any:
        return pyproximal.optimization.primal.ProximalGradient(
            pyproximal.L2(Op=operator, b=data.sums),
            pyproximal.L1(sigma=data.penalty),
            x0=data.start.copy(),
            tau=float(data.step),
            niter=data.iterations,
            acceleration="fista",
        )

    yield Method("pyproximal fista, operator", data.kind.name, solve, np.asarray)


def _sporco(data: _Data) -> Iterator[Method]:
    from sporco.pgm import bpdn

    def solve() -> Any:
        options = bpdn.BPDN.Options(
            {
                "MaxMainIter": data.iterations,
                "L": data.problem.lipschitz,
                "RelStopTol": 0.0,
                "X0": data.start[:, None],
                "DataType": data.kind,
            }
        )
        return bpdn.BPDN(data.matrix, data.sums[:, None], data.penalty, options).solve()

    yield Method("SPORCO pgm.BPDN, dense", data.kind.name, solve, lambda s: np.asarray(s)[:, 0])


def _sigpy(data: _Data) -> Iterator[Method]:
    import sigpy

    class Measured(sigpy.linop.Linop):  # type: ignore[misc]  # sigpy has no types
        def __init__(self, *, turned: bool = False) -> None:
            shapes = [list(data.start.shape), list(data.sums.shape)]
            self._turned = turned
            super().__init__(*(shapes if turned else shapes[::-1]))

        def _apply(self, values: Values) -> Values:
            return data.adjoint(values) if self._turned else data.forward(values)

        def _adjoint_linop(self) -> Any:
            return Measured(turned=not self._turned)

    operator = Measured()

    def solve() -> Any:
        return sigpy.app.LinearLeastSquares(
            operator,
            data.sums,
            x=data.start.copy(),
            proxg=sigpy.prox.L1Reg(data.start.shape, data.penalty),
            alpha=float(data.step),
            accelerate=True,
            max_iter=data.iterations,
            show_pbar=False,
        ).run()

    yield Method("SigPy LinearLeastSquares, operator", data.kind.name, solve, np.asarray)


def _sklearn(data: _Data) -> Iterator[Method]:
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.linear_model import Lasso

    def solve(sweeps: int) -> Any:
        penalty = data.penalty / data.sums.size
        model = Lasso(alpha=penalty, fit_intercept=False, max_iter=sweeps, tol=0, warm_start=True, copy_X=False)
        model.coef_ = data.start.copy()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)
            model.fit(data.fortran, data.sums)
        return model.coef_

    ours = data.problem.gap(_dense(data, 1.0))
    sweeps = next((count for count in range(1, SWEEPS) if data.problem.gap(solve(count)) <= ours), SWEEPS)
    yield Method(f"scikit-learn Lasso, {sweeps} sweeps", data.kind.name, lambda: solve(sweeps), np.asarray)


_LIBRARIES: Final[dict[str, Callable[[_Data], Iterator[Method]]]] = {
    "pylops": _pylops,
    "pyproximal": _pyproximal,
    "sporco": _sporco,
    "sigpy": _sigpy,
    "sklearn": _sklearn,
}
