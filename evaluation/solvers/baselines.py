"""The solvers the paper tried before it chose FISTA: ADMM and smoothed L0 (its section V), for row-orthogonal ΦΨ.

Both need A Aᵀ = ν I of A = ΦΨ, which holds for an SBHE or a noiselet with an orthonormal Ψ, also with rows left out; ν
is then the largest eigenvalue of ΦᵀΦ, and the linear systems inside have closed forms.
"""

import numpy as np

from reconstructor.bases import Basis
from reconstructor.checks import Values
from reconstructor.fista import Observer, check_problem, soft
from skin.operator import Operator


def admm(
    phi: Operator,
    psi: Basis,
    sums_n: Values,
    *,
    penalty_n: float,
    iterations: int,
    coupling: float,
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
    coupling : float
        ρ, above 0.
    """
    estimate, norm, rho = check_problem(phi, psi, sums_n, start), phi.norm_squared, coupling
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
    """
    norm = phi.norm_squared
    estimate = _back(phi, psi, sums_n) / norm
    width = 2 * float(np.abs(estimate).max())
    while width > smallest_n:
        for _ in range(inner):
            estimate = estimate - estimate * np.exp(-np.square(estimate) / (2 * width**2))
            residual = _ahead(phi, psi, estimate) - sums_n
            length = float(np.linalg.norm(residual))
            if length > tolerance_n:
                estimate = estimate - _back(phi, psi, residual) * ((1 - tolerance_n / length) / norm)
        width *= shrink
    return estimate


def _ahead(phi: Operator, psi: Basis, coefficients: Values) -> Values:
    return phi.forward(psi.adjoint(coefficients).reshape(-1))


def _back(phi: Operator, psi: Basis, sums_n: Values) -> Values:
    return psi.forward(phi.adjoint(sums_n).reshape(psi.image_shape))
