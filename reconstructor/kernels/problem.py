"""The tables and constants of one Φ and one prior."""

from collections.abc import Callable
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError
from reconstructor.checks import Values, check_grid_of, placed
from reconstructor.fista import momentum
from reconstructor.kernels.addresses import (
    Indices,
    pyramid_addresses,
    pyramid_levels,
    row_addresses,
    shifted,
    spin_shifts,
    tensor_addresses,
)
from reconstructor.kernels.graph import graph_of, in_runs
from reconstructor.kernels.steps import Problem, Table, usable
from reconstructor.settings import SolverSettings
from skin.measurement import Sbhe

#: The order of pixels of a prior; of all others row by row.
ADDRESSES: Final[dict[str, Callable[[int, int], Indices]]] = {
    "haar-pyramid": pyramid_addresses,
    "haar-tensor": tensor_addresses,
}


def make_problem(  # noqa: PLR0917
    phi: Sbhe, rows: int, columns: int, settings: SolverSettings, kind: np.dtype[Any], edges: Indices | None = None
) -> Problem:
    """Return the tables and constants of a solver; for `edges` see `FusedSolver`."""
    check_grid_of(phi, rows, columns, settings.prior, edges)
    taxel, step = taxels_in_block_order(phi), 1 / (settings.lipschitz_ratio * phi.block_size)
    floor = 0.0 if settings.nonnegative else float(np.finfo(kind).min)
    addresses = ADDRESSES.get(settings.prior, row_addresses)(rows, columns)
    if edges is not None:
        rank = in_runs(edges, rows * columns)
        addresses, edges = rank.reshape(rows, columns), rank[edges]
    shifts = spin_shifts(settings.spins, rows, columns)
    gaps = addresses.ravel()[~phi.is_wired]
    # What empty places take from the image is 0: a gap, or what follows the image.
    none = np.full(phi.empty, gaps[0] if gaps.size else rows * columns)
    to_blocks = [np.append(shifted(addresses, shift).ravel(), none)[taxel] for shift in shifts]
    to_image = [_inverse(each, taxel < rows * columns, rows * columns) for each in to_blocks]
    graph = graph_of(rows, columns, gaps, edges)
    numbers = (step, settings.penalty_n * step, floor, 0.5**0.5, 1 / graph.bound)
    return Problem(
        places=places_of_sums(phi),
        tables=_stacked(to_image, to_blocks),
        deliver=_inverse(taxel, taxel < rows * columns, rows * columns).astype(np.uint16),
        gaps=gaps.astype(np.uint16),
        graph=graph,
        numbers=np.array(numbers, kind),
        momentum=momentum(settings.iterations).astype(kind),
        blocks=phi.blocks,
        rows=rows,
        columns=columns,
        levels=pyramid_levels(rows, columns) if settings.prior.endswith("pyramid") else 0,
        scaled_start=settings.scaled_start,
    )


def _inverse(of_places: Indices, held: npt.NDArray[np.bool_], size: int) -> Indices:
    """Return the place of each of `size` pixels; 0 for a pixel without one."""
    found = np.zeros(size, np.intp)
    found[of_places[held]] = np.flatnonzero(held)
    return found


def _stacked(*rows: list[Indices]) -> Table:
    """Stack arrays of different lengths, with zeros after the shorter."""
    size = max(each.size for row in rows for each in row)
    return np.array([[np.pad(each, (0, size - each.size)) for each in row] for row in rows]).astype(np.uint16)


def taxels_in_block_order(phi: Sbhe) -> Indices:
    """Return the taxel at each place of block order, shape (places,): by place in the block, then by block."""
    return phi.order.reshape(phi.blocks, phi.block_size).T.ravel()


def places_of_sums(phi: Sbhe) -> Table:
    """Return the place of every sum in block order, shape (m,)."""
    return (phi.row_of_sum * phi.blocks + phi.block_of_sum).astype(np.uint16)


def checked(sums_n: Values, weights: Values, shape: tuple[int, ...], kind: np.dtype[Any]) -> tuple[Values, Values]:
    """Check the sums and weights of one cycle, and return them for the compiled solvers."""
    sums, counting = placed("sums", sums_n, shape, kind), placed("weights", weights, shape, kind)
    if not usable(sums.reshape(-1), counting.reshape(-1)):
        raise InputError("expected weights of 0 to 1, and sums of at most 1e6 N where the weight is not 0")
    return sums, counting
