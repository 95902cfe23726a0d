"""Independent work in parallel, on this machine's cores."""

import contextlib
import signal
import threading
import warnings
from collections.abc import Callable, Generator, Iterator, Sequence
from typing import TypeVar

from canskin.errors import InputError

Result = TypeVar("Result")
Call = Callable[[], Result]


def in_parallel(calls: Sequence[Call[Result]], jobs: int, *, ahead: int | None = None) -> Generator[tuple[int, Result]]:
    """Yield the index and the result of each call, in the order of completion.

    Parameters
    ----------
    calls : sequence of callable
        Called without arguments; calls and results must be picklable.
    jobs : int
        Number of processes, each with one thread; 1 uses this process.
    ahead : int, optional
        Calls per job that run before their results are yielded, to limit the memory of large results; default: all.
    """
    if jobs < 1:
        raise InputError(f"expected 1 job or more, got {jobs}")
    if jobs == 1 or len(calls) < 2:
        for place, call in enumerate(calls):
            yield place, call()
        return
    size = len(calls) if ahead is None else ahead * jobs
    with _backend():
        for first in range(0, len(calls), max(1, size)):
            with _begun(calls[first : first + size], jobs) as done:
                for place, result in done:
                    yield first + place, result


@contextlib.contextmanager
def _begun(calls: Sequence[Call[Result]], jobs: int) -> Iterator[Iterator[tuple[int, Result]]]:
    """Start a batch and yield finished results; unfinished calls are cancelled silently."""
    from joblib import Parallel, delayed

    # A terminal sends Ctrl-C to every process: workers ignore it, and this process ends them.
    with _ctrl_c_ignored():
        done = Parallel(n_jobs=jobs, return_as="generator_unordered")(
            delayed(_one)(place, call) for place, call in enumerate(calls)
        )
    try:
        yield done
    finally:
        with warnings.catch_warnings(action="ignore"):
            done.close()


def _one(place: int, call: Call[Result]) -> tuple[int, Result]:
    return place, call()


@contextlib.contextmanager
def _ctrl_c_ignored() -> Iterator[None]:
    """Ignore SIGINT inside the ``with``; processes that start inside ignore SIGINT for their whole life."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@contextlib.contextmanager
def _backend() -> Iterator[None]:
    from joblib import parallel_config
    from joblib.externals.loky import get_reusable_executor

    try:
        with parallel_config(backend="loky", inner_max_num_threads=1):
            yield
    finally:
        # Shut down here: at the end of the program, Ctrl-C would print a traceback, and an interrupted executor
        # would leave processes for which the program then waits without end.
        with _ctrl_c_ignored():
            get_reusable_executor(reuse=True).shutdown(wait=True, kill_workers=True)
