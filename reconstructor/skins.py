"""Several skins at once, each with its own Φ, grid and solver, on a pool of threads.

The compiled solvers let go of the interpreter while they run, so that threads share the cores of one process.
"""

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from types import TracebackType
from typing import Any, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from reconstructor.engine import Reconstructor
from skin.errors import InputError


class Cycle(NamedTuple):
    """What one skin measured in one cycle; see `reconstructor.engine.Reconstructor.solve`.

    Attributes
    ----------
    sums_n : shape (m,)
        Newtons.
    valid : array of bool, shape (m,)
    """

    sums_n: npt.NDArray[np.floating[Any]]
    valid: npt.NDArray[np.bool_]


class SkinPool:
    """Reconstructors by the name of their skin, solved side by side; a context manager.

    Every thread has its own share of the skins, so that a round costs one hand-over for each thread.

    Parameters
    ----------
    engines : mapping of str to Reconstructor
        Each for one skin alone: an engine remembers its own past.
    threads : int
        Those that work at once; one for each core is the most that pays.

    Raises
    ------
    InputError
        Without an engine or a thread, or if one engine stands under two names.
    """

    def __init__(self, engines: Mapping[str, Reconstructor], threads: int) -> None:
        if not engines or len({id(engine) for engine in engines.values()}) < len(engines):
            raise InputError("expected one reconstructor of its own for each skin, and one skin at least")
        if threads < 1:
            raise InputError(f"expected at least 1 thread, got {threads}")
        self._engines = dict(engines)
        self._threads = min(threads, len(engines))
        self._pool = ThreadPoolExecutor(self._threads, "skins")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, _kind: type[BaseException] | None, _error: BaseException | None, _trace: TracebackType | None
    ) -> None:
        self.close()

    def solve(self, cycles: Mapping[str, Cycle]) -> dict[str, npt.NDArray[np.float32]]:
        """Return an image for each skin that sent a cycle, shape (rows, columns), newtons.

        Raises
        ------
        InputError
            If a skin is unknown, or its cycle is refused by its reconstructor; the message names it. The others are
            solved all the same.
        """
        unknown = sorted(set(cycles) - set(self._engines))
        if unknown:
            raise InputError(f"unknown skin '{unknown[0]}': expected one of {', '.join(self._engines)}")
        names = list(cycles)
        shares = [names[first :: self._threads] for first in range(min(self._threads, len(names)))]
        images: dict[str, npt.NDArray[np.float32]] = {}
        refused: list[InputError] = []
        for share in self._pool.map(lambda each: self._solve_share(each, cycles), shares):
            for name, made in share:
                if isinstance(made, InputError):
                    refused.append(InputError(f"skin '{name}': {made}"))
                else:
                    images[name] = made
        if refused:
            raise refused[0]
        return {name: images[name] for name in names}

    def close(self) -> None:
        """End the threads."""
        self._pool.shutdown()

    def _solve_share(
        self, names: list[str], cycles: Mapping[str, Cycle]
    ) -> list[tuple[str, npt.NDArray[np.float32] | InputError]]:
        made: list[tuple[str, npt.NDArray[np.float32] | InputError]] = []
        for name in names:
            try:
                made.append((name, self._engines[name].solve(*cycles[name])))
            except InputError as error:
                made.append((name, error))
        return made
