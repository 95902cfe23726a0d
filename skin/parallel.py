"""Independent work in parallel: on this machine's cores, or on a Dask cluster."""

import contextlib
import signal
import threading
import warnings
from collections.abc import Callable, Generator, Iterator, Sequence
from typing import Any, Final, TypeVar

from skin.errors import InputError

_CONNECT_S: Final = 10

Result = TypeVar("Result")
Call = Callable[[], Result]


def in_parallel(
    calls: Sequence[Call[Result]], jobs: int, *, cluster: str | None = None, ahead: int | None = None
) -> Generator[tuple[int, Result]]:
    """Yield the place and the result of each call, in the order they are done.

    Parameters
    ----------
    calls : sequence of callable
        Without arguments; they and their results must be fit to be sent to another process.
    jobs : int
        Processes at the same time, each on one thread; 1 works in this one. On a cluster it only scales `ahead`.
    cluster : str, optional
        Address of a Dask scheduler whose workers have this project installed.
    ahead : int, optional
        Calls per job between two gatherings, where results are so large that they must not pile up; default all.

    Raises
    ------
    InputError
        If `jobs` is below 1, Dask is not installed, or no scheduler answers.
    """
    if jobs < 1:
        raise InputError(f"expected 1 job or more, got {jobs}")
    if cluster is None and (jobs == 1 or len(calls) < 2):
        for place, call in enumerate(calls):
            yield place, call()
        return
    size = len(calls) if ahead is None else ahead * jobs
    with _backend(cluster):
        for first in range(0, len(calls), max(1, size)):
            with _begun(calls[first : first + size], jobs) as done:
                for place, result in done:
                    yield first + place, result


@contextlib.contextmanager
def _begun(calls: Sequence[Call[Result]], jobs: int) -> Iterator[Iterator[tuple[int, Result]]]:
    """Start a batch and give what is done; what is not at the end is given up without a word."""
    from joblib import Parallel, delayed

    # A terminal sends Ctrl-C to every process: those that work shall leave it to this one to end them.
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
    """Ignore SIGINT for a moment; processes that start meanwhile ignore it for good."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@contextlib.contextmanager
def _backend(cluster: str | None) -> Iterator[None]:
    from joblib import parallel_config
    from joblib.externals.loky import get_reusable_executor

    if cluster is None:
        try:
            with parallel_config(backend="loky", inner_max_num_threads=1):
                yield
        finally:
            # Left to the end of the program, it would wait for its processes where Ctrl-C is not quiet; interrupted,
            # it would leave them, and the program would wait for them for ever.
            with _ctrl_c_ignored():
                get_reusable_executor(reuse=True).shutdown(wait=True, kill_workers=True)
        return
    with _client(cluster), parallel_config(backend="dask"):
        yield


def _client(cluster: str) -> Any:
    try:
        from distributed import Client
    except ImportError as error:
        raise InputError('a Dask cluster needs the package distributed: pip install "canskin[cluster]"') from error
    try:
        return Client(cluster, timeout=_CONNECT_S)
    except (OSError, ValueError, TypeError) as error:
        raise InputError(f"no Dask scheduler answers at '{cluster}': {error or type(error).__name__}") from error
