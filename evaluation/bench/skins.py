"""``skin bench skins``: several skins, each with its own Φ, in one process on more and more threads."""

import os
import time
from typing import Any, Final

import numpy as np

from evaluation.bench.problem import NOISE_N, TURN_S
from reconstructor.engine import Reconstructor
from reconstructor.skins import Cycle, SkinPool
from skin.measurement import sbhe

#: Skins of the default skin's size at once.
SKINS: Final = (1, 2, 4, 8)
TAXELS, SUMS, SIDE = 4096, 1024, 64


def run(rounds: int) -> dict[str, Any]:
    """Return rows of skins, threads and milliseconds for one cycle of all, and how much faster than on one thread."""
    rows: list[dict[str, Any]] = []
    cores = os.cpu_count() or 1
    for count in SKINS:
        alone_ms = 0.0
        for threads in (each for each in SKINS if each <= min(count, cores)):
            ms = 1e3 * float(np.median([_time_s(count, threads) for _ in range(rounds)]))
            alone_ms = ms if threads == 1 else alone_ms
            rows.append({"skins": count, "threads": threads, "ms": ms, "speed_up": alone_ms / ms})
    return {"rows": rows}


def _time_s(count: int, threads: int) -> float:
    """Return the seconds one cycle of all skins takes, averaged over `TURN_S`."""
    engines, cycles = {}, {}
    for seed in range(count):
        phi, name = sbhe(TAXELS, SUMS, seed=seed), f"skin {seed}"
        felt = np.maximum(NOISE_N * np.random.default_rng(seed).standard_normal(TAXELS), 0)
        engines[name] = Reconstructor(phi, SIDE, SIDE)
        engines[name].warm_up()
        cycles[name] = Cycle(np.asarray(phi.forward(felt), np.float32), np.ones(SUMS, np.bool_))
    with SkinPool(engines, threads) as pool:
        pool.solve(cycles)
        started_s, calls, elapsed_s = time.perf_counter(), 0, 0.0
        while elapsed_s < TURN_S:
            pool.solve(cycles)
            calls += 1
            elapsed_s = time.perf_counter() - started_s
    return elapsed_s / calls
