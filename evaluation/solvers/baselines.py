"""The solvers the paper tried before it chose FISTA: ADMM and smoothed L0 (its section V), for row-orthogonal ΦΨ.

Both need A Aᵀ = ν I of A = ΦΨ, which holds for an SBHE or a noiselet with an orthonormal Ψ, also with rows left out.
Then the linear systems inside them have closed forms.
"""

import math

import numpy as np

from evaluation.result import Values
from reconstructor.bases import Basis
from reconstructor.checks import check_above_zero, check_iterations, check_penalty
from reconstructor.fista import Observer, check_problem
from reconstructor.proximal import soft
from skin.errors import InputError
from skin.operator import Operator


def admm(
    phi: Operator,
    psi: Basis,
    sums_n: Values,
    *,
    penalty_n: float,
    iterations: int,
    coupling: float | None = None,
    start: Values | None = None,
    observe: Observer | None = None,
) -> Values:
    """Return the coefficients s that minimise ½‖ΦΨs - y‖² + λ‖s‖₁, by alternating directions (Boyd et al. 2011).

        u ← (AᵀA + ρ I)⁻¹ (Aᵀy + ρ (s - w)),   s ← soft(u + w, λ / ρ),   w ← w + u - s

    with (AᵀA + ρ I)⁻¹ = (I - AᵀA / (ρ + ν)) / ρ.

    Parameters
    ----------
    phi, psi, sums_n, penalty_n, start, observe
        As for `reconstructor.fista.fista`, the same objective; Ψ orthonormal.
    coupling : float, optional
        ρ, above 0; without it ν / 10, which suits forces of some millinewtons.

    Raises
    ------
    InputError
        If Ψ is not orthonormal, the sizes do not fit, or a number is out of its range.
    """
    estimate = check_problem(phi, psi, sums_n, start)
    check_penalty(penalty_n)
    check_iterations(iterations)
    norm = _row_norm(phi, psi)
    rho = norm / 10 if coupling is None else coupling
    check_above_zero("coupling", rho)
    dual = np.zeros_like(estimate)
    pulled = _back(phi, psi, sums_n)
    for k in range(iterations):
        right = pulled + rho * (estimate - dual)
        fitted = (right - _back(phi, psi, _ahead(phi, psi, right)) / (rho + norm)) / rho
        estimate = soft(fitted + dual, penalty_n / rho)
        dual = dual + fitted - estimate
        if observe is not None:
            observe(k + 1, estimate)
    return estimate


def smoothed_l0(
    phi: Operator,
    psi: Basis,
    sums_n: Values,
    *,
    tolerance_n: float,
    smallest_n: float,
    shrink: float = 0.7,
    inner: int = 3,
    observe: Observer | None = None,
) -> Values:
    """Return coefficients with few entries above `smallest_n` that explain the sums (Mohimani et al. 2009).

    Maximises Σ exp(-s² / 2σ²) by gradient steps s ← s - s exp(-s² / 2σ²), for σ falling from twice the largest
    coefficient to `smallest_n`; each step is followed by the projection onto ‖ΦΨs - y‖ ≤ `tolerance_n` (the form
    for noisy sums).

    Parameters
    ----------
    tolerance_n : float
        Largest norm of the residual; 0 asks for ΦΨs = y.
    smallest_n : float
        Last σ, about the size of a coefficient that means nothing.
    shrink : float
        Ratio of successive σ, between 0 and 1.
    inner : int
        Steps for each σ.

    Raises
    ------
    InputError
        If Ψ is not orthonormal, the sizes do not fit, or a number is out of its range.
    """
    check_problem(phi, psi, sums_n, None)
    norm = _row_norm(phi, psi)
    check_iterations(inner)
    if not (0 < shrink < 1 and 0 < smallest_n < math.inf and 0 <= tolerance_n < math.inf):
        raise InputError(
            "smoothed L0 needs 0 < shrink < 1, smallest_n > 0 and tolerance_n >= 0: got "
            f"{shrink}, {smallest_n} and {tolerance_n}"
        )
    estimate = _back(phi, psi, sums_n) / norm
    width = 2 * float(np.abs(estimate).max())
    turn = 0
    while width > smallest_n:
        for _ in range(inner):
            estimate = estimate - estimate * np.exp(-np.square(estimate) / (2 * width**2))
            residual = _ahead(phi, psi, estimate) - sums_n
            length = float(np.linalg.norm(residual))
            if length > tolerance_n:
                estimate = estimate - _back(phi, psi, residual) * ((1 - tolerance_n / length) / norm)
            turn += 1
            if observe is not None:
                observe(turn, estimate)
        width *= shrink
    return estimate


def _row_norm(phi: Operator, psi: Basis) -> float:
    """Return ν of A Aᵀ = ν I, after trying it on one vector."""
    probe = np.random.default_rng(0).normal(size=phi.shape[0])
    if not np.allclose(_ahead(phi, psi, _back(phi, psi, probe)), phi.norm_squared * probe):
        raise InputError("ADMM and smoothed L0 need an orthonormal basis: use Haar, D4 or the cosine transform")
    return phi.norm_squared


def _ahead(phi: Operator, psi: Basis, coefficients: Values) -> Values:
    return phi.forward(psi.adjoint(coefficients).reshape(-1))


def _back(phi: Operator, psi: Basis, sums_n: Values) -> Values:
    return psi.forward(phi.adjoint(sums_n).reshape(psi.image_shape))
