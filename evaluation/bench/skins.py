"""``skin bench skins``: several skins, each with its own Φ, in one process on more and more threads."""

import os
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from functools import partial
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from evaluation.bench.timing import race
from reconstructor.engine import Reconstructor
from skin.measurement import sbhe
from skin.taxel import NOISE_N

#: Skins of the default skin's size at once.
SKINS: Final = (1, 2, 4, 8)
TAXELS, SUMS, SIDE = 4096, 1024, 64

Cycle = tuple[npt.NDArray[np.float32], npt.NDArray[np.bool_]]


def run(rounds: int) -> dict[str, Any]:
    """Return rows of skins, threads, median and least milliseconds for one cycle of all, and the gain over one thread.

    The gain is that of the least times: on a machine that others use too, two threads rarely have two cores for long.
    """
    cores = os.cpu_count() or 1
    cycles = [_cycle(seed) for seed in range(max(SKINS))]
    cases = [(count, threads) for count in SKINS for threads in SKINS if threads <= min(count, cores)]
    with ExitStack() as stack:
        calls = []
        for count, threads in cases:
            skins = list(zip(_engines(count), cycles, strict=False))
            pool = stack.enter_context(ThreadPoolExecutor(threads))
            calls.append(partial(_solve_all, pool, [skins[first::threads] for first in range(threads)]))
        times_s = dict(zip(cases, race(calls, rounds), strict=True))
    rows = []
    for (count, threads), each in times_s.items():
        row = {"skins": count, "threads": threads, "ms": 1e3 * float(np.median(each)), "ms_least": 1e3 * min(each)}
        rows.append({**row, "speed_up": min(times_s[count, 1]) / min(each)})
    return {"rows": rows}


def _cycle(seed: int) -> Cycle:
    """Return the sums of an idle skin, newtons, and which are valid: all."""
    felt = np.maximum(NOISE_N * np.random.default_rng(seed).standard_normal(TAXELS), 0)
    return np.asarray(sbhe(TAXELS, SUMS, seed=seed).forward(felt), np.float32), np.ones(SUMS, np.bool_)


def _engines(count: int) -> list[Reconstructor]:
    engines = [Reconstructor(sbhe(TAXELS, SUMS, seed=seed), SIDE, SIDE) for seed in range(count)]
    for engine in engines:
        engine.warm_up()
    return engines


def _solve_all(pool: ThreadPoolExecutor, shares: list[list[tuple[Reconstructor, Cycle]]]) -> None:
    """Solve one cycle of all skins, a share of them on each thread: the solvers run without the interpreter's lock."""
    list(pool.map(_solve, shares))


def _solve(share: list[tuple[Reconstructor, Cycle]]) -> None:
    for engine, cycle in share:
        engine.solve(*cycle)
