"""Basis pursuit: the sparsest coefficients of an image in an overcomplete Ψ, in the sense of their sum (Table I)."""

import numpy as np

from canskin.errors import InputError
from reconstructor.bases import Basis
from reconstructor.checks import Values
from reconstructor.fista import soft


def basis_pursuit(psi: Basis, image: Values, *, relative_error: float = 1e-3, iterations: int = 20_000) -> Values:
    """Return the s of least ‖s‖₁ with Ψs = x, by the primal-dual method of Chambolle and Pock (2011).

        u ← u + σ (Ψs̄ - x),   s' ← soft(s - τ Ψᵀu, τ),   s̄ ← 2s' - s,   σ τ ‖Ψ‖² < 1

    A fifth of the largest value of the image stands for a typical coefficient, which balances τ against σ.

    Raise InputError if the method does not converge.

    Parameters
    ----------
    image : array, shape psi.image_shape
    relative_error : float
        Ends when ‖Ψs - x‖ ≤ relative_error · ‖x‖ and ‖s‖₁ is as close to its lower bound, the dual objective.
    iterations : int
        Most iterations.
    """
    if not image.any():
        return np.zeros(psi.shape, image.dtype)
    norm = _norm(psi)
    size = float(np.abs(image).max()) / 5
    tau, sigma = 0.1 * size, 0.99 / (norm**2 * 0.1 * size)
    s = np.zeros(psi.shape, image.dtype)
    beyond, dual = s, np.zeros_like(image)
    length = float(np.linalg.norm(image))
    for k in range(iterations):
        dual = dual + sigma * (psi.adjoint(beyond) - image)
        pulled = psi.forward(dual)
        previous, s = s, soft(s - tau * pulled, tau)
        beyond = 2 * s - previous
        if k % 20 < 19 or _gap(image, s, dual, pulled) > relative_error:
            continue
        if np.linalg.norm(psi.adjoint(s) - image) <= relative_error * length:
            return s
    raise InputError(f"basis pursuit did not converge in {iterations} iterations: allow more, or a larger error")


def _gap(image: Values, s: Values, dual: Values, pulled: Values) -> float:
    """Return how far ‖s‖₁ is above its bound -uᵀx / max(1, ‖Ψᵀu‖∞), relative to ‖s‖₁."""
    total = float(np.abs(s).sum())
    bound = -float(np.vdot(dual, image)) / max(1.0, float(np.abs(pulled).max()))
    return (total - bound) / total if total else float("inf")


def _norm(psi: Basis) -> float:
    """Return ‖Ψ‖, a little from above, by power iteration."""
    image: Values = np.random.default_rng(0).normal(size=psi.image_shape)
    value = 1.0
    for _ in range(100):
        image = psi.adjoint(psi.forward(image / value))
        value = float(np.linalg.norm(image))
    return 1.02 * float(np.sqrt(value))
