"""``skin bench skins``: several skins, each with its own Φ, in one process on more and more threads."""

import os
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from evaluation.bench.problem import TURN_S
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
    times_ms: dict[tuple[int, int], list[float]] = {case: [] for case in cases}
    with ExitStack() as stack:
        pools = {case: (stack.enter_context(ThreadPoolExecutor(case[1])), _engines(case[0])) for case in cases}
        for turn in range(rounds + 1):
            for case, (pool, engines) in pools.items():
                elapsed_ms = 1e3 * _turn_s(pool, case[1], list(zip(engines, cycles, strict=False)))
                if turn:
                    times_ms[case].append(elapsed_ms)
    rows = []
    for (count, threads), each in times_ms.items():
        row = {"skins": count, "threads": threads, "ms": float(np.median(each)), "ms_least": min(each)}
        rows.append({**row, "speed_up": min(times_ms[count, 1]) / min(each)})
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


def _turn_s(pool: ThreadPoolExecutor, threads: int, skins: list[tuple[Reconstructor, Cycle]]) -> float:
    """Return the seconds one cycle of all skins takes, averaged over `TURN_S`; every thread has a share of the skins.

    The compiled solvers let go of the interpreter while they run.
    """
    shares = [skins[first::threads] for first in range(threads)]
    started_s, calls, elapsed_s = time.perf_counter(), 0, 0.0
    while elapsed_s < TURN_S:
        list(pool.map(_solve, shares))
        calls += 1
        elapsed_s = time.perf_counter() - started_s
    return elapsed_s / calls


def _solve(share: list[tuple[Reconstructor, Cycle]]) -> None:
    for engine, cycle in share:
        engine.solve(*cycle)
