"""FISTA for arrays of any library of the Python array standard, such as NumPy, PyTorch and CuPy.

    x' = P(z - G(z)),   z' = x' + β (x' - x),   z = x at first                      (Beck and Teboulle 2009)

`iterate` is this loop, G a step down a gradient and P a proximal step. `fista` is the loop for any Φ and Ψ in NumPy:

    min over s of  ½‖ΦΨs - y‖² + λ‖s‖₁,   x = Ψs

With the factor ½ steps are 1 / L and thresholds λ / L. With Φ of ±1 and forces in newtons, λ is in newtons. L must be
at least the largest eigenvalue of (ΦΨ)ᵀΦΨ: `Operator.norm_squared` exactly for an orthonormal Ψ, `largest_eigenvalue`
for any other. The paper takes twice this value, the L of the objective without the factor ½. In this convention the
paper's tables follow with the printed λ = 1 for noiselets, with λ = 0.01 for an SBHE (the printed λ is 0.1), and with
the momentum reset in every time step.
"""

from collections.abc import Callable, Iterable
from typing import Any, Final, TypeVar

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError
from reconstructor.bases import Basis
from reconstructor.checks import Values, check_iterations, check_values
from skin.operator import Operator
from skin.ranges import require_above_zero, require_number

#: Called with the number of the iteration, from 1, and the estimate after it.
Observer = Callable[[int, Values], None]
_RELATIVE_ERROR: Final = 1e-4
#: An array of any library.
Array = TypeVar("Array")


def clipped(values: Any, limit: Any, xp: Any = np) -> Any:
    """Return values between -limit and limit; `xp` is the library of the arrays."""
    return xp.maximum(xp.minimum(values, limit), -limit)


def soft(values: Array, threshold: Any, xp: Any = np) -> Array:
    """Return sign(v) · max(|v| - threshold, 0), the proximal step of threshold · ‖·‖₁."""
    shrunken: Array = values - clipped(values, threshold, xp)
    return shrunken


def momentum(iterations: int) -> npt.NDArray[np.float64]:
    """Return (t_k - 1) / t_{k+1} for k = 1 … iterations, with t_1 = 1 and t_{k+1} = (1 + √(1 + 4t_k²)) / 2."""
    times = np.ones(iterations + 1)
    for k in range(iterations):
        times[k + 1] = (1 + np.sqrt(1 + 4 * times[k] ** 2)) / 2
    return (times[:-1] - 1) / times[1:]


def iterate(
    start: Any,
    descent: Callable[[Any], Any],
    proximal: Callable[[Any, int], Any],
    weights: Iterable[Any],
    observe: Callable[[int, Any], None] | None = None,
) -> Any:
    """Return the estimate after one iteration for each of the weights β.

    Parameters
    ----------
    start : array
    descent : callable
        G: of z, what a step down the gradient takes off.
    proximal : callable
        P: of an array and the number of the iteration, from 0.
    weights : numbers, or arrays of one
        As of `momentum`.
    observe : callable
        Called with the number of the iteration, from 1, and the estimate after it, which it must not change.
    """
    estimate = ahead = start
    for k, weight in enumerate(weights):
        before, estimate = estimate, proximal(ahead - descent(ahead), k)
        ahead = estimate + weight * (estimate - before)
        if observe is not None:
            observe(k + 1, estimate)
    return estimate


def fista(
    phi: Operator,
    psi: Basis,
    sums_n: Values,
    *,
    penalty_n: float,
    lipschitz: float,
    iterations: int,
    start: Values | None = None,
    observe: Observer | None = None,
) -> Values:
    """Return the coefficients s after a fixed number of iterations.

    Parameters
    ----------
    phi, psi : operators
        Φ of shape (m, n) and Ψ, whose image has n pixels.
    sums_n : array, shape (m,)
        y in newtons.
    penalty_n : float
        λ in newtons.
    lipschitz : float
        L, at least the largest eigenvalue of (ΦΨ)ᵀΦΨ.
    start : array, shape psi.shape
        Coefficients to start from, default zeros; for a warm start those of the previous cycle.
    observe : callable
        Called with every estimate, which it must not change.
    """
    start = check_problem(phi, psi, sums_n, start)
    require_number("the penalty λ", penalty_n)
    require_above_zero("L", lipschitz)
    check_iterations(iterations)

    def descent(ahead: Values) -> Values:
        residual = phi.forward(psi.adjoint(ahead).reshape(-1)) - sums_n
        return psi.forward(phi.adjoint(residual).reshape(psi.image_shape)) / lipschitz

    def shrink(values: Values, _iteration: int) -> Values:
        return soft(values, penalty_n / lipschitz)

    # Numbers of Python leave float32 as it is.
    made: Values = iterate(start, descent, shrink, momentum(iterations).tolist(), observe)
    return made


def largest_eigenvalue(phi: Operator, psi: Basis) -> float:
    """Return the largest eigenvalue of (ΦΨ)ᵀΦΨ, from above by 1e-4 of it (Lanczos).

    Computed from ΦΨΨᵀΦᵀ, a smaller matrix with the same eigenvalue. Leaving out rows of Φ never increases the
    eigenvalue, so it is a valid L for every mask.
    """
    from scipy.sparse.linalg import LinearOperator, eigsh

    check_sizes(phi, psi)

    def gram(y: Values) -> Values:
        image = phi.adjoint(y).reshape(psi.image_shape)
        return phi.forward(psi.adjoint(psi.forward(image)).reshape(-1))

    size = phi.shape[0]
    if size == 1:  # Lanczos needs two
        return float(gram(np.ones(1))[0])
    start = np.random.default_rng(0).normal(size=size)
    operator = LinearOperator((size, size), matvec=gram, dtype=np.float64)
    (value,) = eigsh(operator, k=1, tol=_RELATIVE_ERROR / 10, v0=start, return_eigenvectors=False)
    return float(value) * (1 + _RELATIVE_ERROR)


def check_sizes(phi: Operator, psi: Basis) -> None:
    """Raise InputError unless the image of Ψ has as many pixels as Φ has taxels."""
    pixels = psi.image_shape[0] * psi.image_shape[1]
    if pixels != phi.shape[1]:
        raise InputError(f"Φ measures {phi.shape[1]} taxels but the image of Ψ has {pixels}")


def check_problem(phi: Operator, psi: Basis, sums_n: Values, start: Values | None) -> Values:
    """Return the coefficients to start from, by default zeros; raise InputError unless sizes and dtypes fit."""
    check_sizes(phi, psi)
    check_values("sums", sums_n, phi.shape[:1])
    if start is None:
        return np.zeros(psi.shape, sums_n.dtype)
    check_values("start", start, psi.shape)
    return start


def objective(phi: Operator, psi: Basis, sums_n: Values, coefficients: Values, penalty_n: float) -> float:
    """Return ½‖ΦΨs - y‖² + λ‖s‖₁, newtons squared; raises as `fista` does."""
    check_problem(phi, psi, sums_n, coefficients)
    require_number("the penalty λ", penalty_n)
    residual = phi.forward(psi.adjoint(coefficients).reshape(-1)) - sums_n
    return float(0.5 * residual @ residual + penalty_n * np.abs(coefficients).sum())
