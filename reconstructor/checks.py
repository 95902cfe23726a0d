"""Checks of the input of bases and solvers."""

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError
from skin.phi import Sbhe

Values = npt.NDArray[np.floating[Any]]

#: Largest sum, newtons: far above any skin; larger sums would overflow float32 inside a solver.
LARGEST_N: Final = 1e6
#: Upper limit of iterations, to catch typing errors: a second for a small image; twenty iterations are usual.
MOST_ITERATIONS: Final = 100_000
_KINDS: Final = (np.dtype(np.float32), np.dtype(np.float64))


def float_kind(dtype: npt.DTypeLike) -> np.dtype[Any]:
    """Return float32 or float64 as NumPy dtype; raise InputError for any other dtype."""
    try:
        kind = np.dtype(dtype)
    except TypeError:
        raise InputError(f"expected float32 or float64, got {dtype}") from None
    if kind not in _KINDS:
        raise InputError(f"expected float32 or float64, got {kind}")
    return kind


def is_whole(value: object) -> bool:
    """Tell whether a number has an integer type."""
    return isinstance(value, int | np.integer)


def check_values(name: str, values: Any, shape: tuple[int, ...]) -> None:
    """Raise InputError unless `values` are finite float32 or float64 of this shape."""
    if not isinstance(values, np.ndarray) or values.dtype not in _KINDS or values.shape != shape:
        raise InputError(f"{name}: expected an array of float32 or float64 of shape {shape}, got {_seen(values)}")
    if not np.isfinite(values).all():
        raise InputError(f"{name}: expected finite numbers, got NaN or infinity")


def placed(name: str, values: Any, shape: tuple[int, ...], kind: np.dtype[Any]) -> Values:
    """Return a contiguous array for a compiled solver; raise InputError unless shape and dtype fit."""
    if not isinstance(values, np.ndarray) or values.dtype != kind or values.shape != shape:
        raise InputError(f"{name}: expected an array of {kind} of shape {shape}, got {_seen(values)}")
    return np.ascontiguousarray(values)


def check_estimate(values: Any, shape: tuple[int, ...], kind: np.dtype[Any]) -> None:
    """Raise InputError unless a compiled solver can change an estimate in place."""
    if placed("estimate", values, shape, kind) is not values or not values.flags.writeable:
        raise InputError("estimate: expected contiguous, writeable memory, as `new_estimate` returns")


def check_grid(rows: int, columns: int) -> None:
    """Raise InputError unless both sides are powers of two, 8 to 256."""
    for size in (rows, columns):
        if not is_whole(size) or size & (size - 1) or not 8 <= size <= 256:
            raise InputError(f"a basis needs sides that are powers of two, 8 to 256: got {rows} x {columns}")


def check_sbhe(phi: object) -> None:
    """Raise InputError unless Φ is an SBHE."""
    if not isinstance(phi, Sbhe):
        raise InputError(f"a compiled solver needs an SBHE, got {type(phi).__name__}: use fista")


def check_grid_of(phi: Sbhe, rows: int, columns: int, prior: str, edges: object = None) -> None:
    """Raise InputError unless Φ is an SBHE of rows x columns taxels; a prior with a basis needs a full grid."""
    check_sbhe(phi)
    count = phi.shape[1]
    if rows * columns != count:
        raise InputError(f"Φ measures {count} taxels but the grid has {rows} x {columns} = {rows * columns}")
    if prior == "variation":
        return
    if edges is not None or phi.empty or not phi.is_wired.all():
        raise InputError("a basis needs a grid without gaps, and full blocks: expected 'variation'")
    check_grid(rows, columns)


def check_iterations(iterations: int) -> None:
    """Raise InputError unless `iterations` is 1 to `MOST_ITERATIONS`."""
    if not is_whole(iterations) or iterations < 1:
        raise InputError(f"expected at least 1 iteration, got {iterations}")
    if iterations > MOST_ITERATIONS:
        raise InputError(f"expected at most {MOST_ITERATIONS} iterations, got {iterations}")


def _seen(values: Any) -> str:
    """Return the type, or dtype and shape, of a wrong value as text."""
    if not isinstance(values, np.ndarray):
        return type(values).__name__
    return f"{values.dtype} of shape {values.shape}"
