"""What one core can do at best, measured: additions and scattered moves a second."""

import time
from collections.abc import Callable
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from reconstructor.kernels.steps import aligned, gather
from shell.compiled import njit

#: Multiplications and additions, fused two by two, on each value in one pass: enough to hide loading it, few enough
#: that many values are in flight.
CHAIN: Final = 8
#: Passes in one call.
PASSES: Final = 50


@njit(cache=True, fastmath=True)
def _chains(values: npt.NDArray[Any], factor: Any, term: Any) -> None:
    for _ in range(PASSES):
        for k in range(values.size):
            x = values[k]
            for _ in range(CHAIN):
                x = x * factor + term
            values[k] = x


@njit(cache=True)
def _moves(target: npt.NDArray[Any], source: npt.NDArray[Any], index: npt.NDArray[Any]) -> None:
    for _ in range(PASSES):
        gather(target, source, index)


def measure_limit(iterations: int, taxels: int = 4096, block_size: int = 32) -> dict[str, float]:
    """Return the least time of an SBHE and Haar solve in float32, were nothing waited for.

    Counted per iteration: two Hadamard transforms (2 n log2 B), the mask and the residual (2 n), the Haar pyramid and
    its inverse (8 n), threshold and momentum (10 n), each addition or multiplication at the measured rate of vector
    instructions (a fused multiplication and addition counts once, for the solver hardly has any); and two
    permutations, 2 n moves at the measured rate of moves. A processor may do both at the same time: the larger of the
    two is then the limit, ``overlapped_ms``.
    """
    values = aligned(taxels, np.dtype(np.float32))
    index = np.random.default_rng(0).permutation(taxels).astype(np.uint16)
    other = aligned(taxels, np.dtype(np.float32))
    chain_s = _least_s(lambda: _chains(values, np.float32(0.5), np.float32(1)))
    move_s = _least_s(lambda: _moves(other, values, index))
    operations_per_s = PASSES * CHAIN * taxels / chain_s
    moves_per_s = PASSES * taxels / move_s
    operations = taxels * (2 * np.log2(block_size) + 2 + 8 + 10)
    arithmetic_ms = 1e3 * iterations * operations / operations_per_s
    moves_ms = 1e3 * iterations * 2 * taxels / moves_per_s
    return {
        "operations_per_s": operations_per_s,
        "moves_per_s": moves_per_s,
        "arithmetic_ms": float(arithmetic_ms),
        "moves_ms": moves_ms,
        "limit_ms": float(arithmetic_ms) + moves_ms,
        "overlapped_ms": max(float(arithmetic_ms), moves_ms),
    }


def _least_s(run: Callable[[], Any], rounds: int = 300) -> float:
    times = []
    for _ in range(rounds):
        started_s = time.perf_counter()
        run()
        times.append(time.perf_counter() - started_s)
    return min(times)
