"""``skin bench skins``: several skins, each with its own Φ, in one process on more and more threads."""

import os
import time
from contextlib import ExitStack
from typing import Any, Final

import numpy as np

from evaluation.bench.problem import TURN_S
from reconstructor.engine import Reconstructor
from reconstructor.skins import Cycle, SkinPool
from skin.measurement import sbhe
from skin.taxel import NOISE_N

#: Skins of the default skin's size at once.
SKINS: Final = (1, 2, 4, 8)
TAXELS, SUMS, SIDE = 4096, 1024, 64


def run(rounds: int) -> dict[str, Any]:
    """Return rows of skins, threads, median and least milliseconds for one cycle of all, and the gain over one thread.

    The gain is that of the least times: on a machine that others use too, two threads rarely have two cores for long.
    """
    cores = os.cpu_count() or 1
    cycles = {f"skin {seed}": _cycle(seed) for seed in range(max(SKINS))}
    cases = [(count, threads) for count in SKINS for threads in SKINS if threads <= min(count, cores)]
    times_ms: dict[tuple[int, int], list[float]] = {case: [] for case in cases}
    with ExitStack() as stack:
        pools = {case: stack.enter_context(_pool(*case)) for case in cases}
        for turn in range(rounds + 1):
            for case, pool in pools.items():
                elapsed_ms = 1e3 * _turn_s(pool, dict(list(cycles.items())[: case[0]]))
                if turn:
                    times_ms[case].append(elapsed_ms)
    rows = []
    for (count, threads), each in times_ms.items():
        row = {"skins": count, "threads": threads, "ms": float(np.median(each)), "ms_least": min(each)}
        rows.append({**row, "speed_up": min(times_ms[count, 1]) / min(each)})
    return {"rows": rows}


def _cycle(seed: int) -> Cycle:
    """Return the sums of an idle skin."""
    felt = np.maximum(NOISE_N * np.random.default_rng(seed).standard_normal(TAXELS), 0)
    return Cycle(np.asarray(sbhe(TAXELS, SUMS, seed=seed).forward(felt), np.float32), np.ones(SUMS, np.bool_))


def _pool(count: int, threads: int) -> SkinPool:
    engines = {f"skin {seed}": Reconstructor(sbhe(TAXELS, SUMS, seed=seed), SIDE, SIDE) for seed in range(count)}
    for engine in engines.values():
        engine.warm_up()
    return SkinPool(engines, threads)


def _turn_s(pool: SkinPool, cycles: dict[str, Cycle]) -> float:
    """Return the seconds one cycle of all skins takes, averaged over `TURN_S`."""
    started_s, calls, elapsed_s = time.perf_counter(), 0, 0.0
    while elapsed_s < TURN_S:
        pool.solve(cycles)
        calls += 1
        elapsed_s = time.perf_counter() - started_s
    return elapsed_s / calls
