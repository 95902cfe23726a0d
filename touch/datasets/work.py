"""Chunks made in parallel: on this machine's cores, or on a Dask cluster."""

import contextlib
import signal
import threading
import warnings
from collections.abc import Generator, Iterator, Sequence
from typing import Any, Final

from skin.errors import BusError, InputError
from touch.contact import Force
from touch.datasets.plan import Task

#: Chunks per process between two gatherings: what is made must not pile up while it is written.
_AHEAD: Final = 4
_CONNECT_S: Final = 10


def made(tasks: Sequence[Task], jobs: int, cluster: str | None = None) -> Generator[tuple[Task, list[Force]]]:
    """Yield each task with the arrays of its files, in the order they are done.

    Parameters
    ----------
    tasks : sequence of Task
        What to make.
    jobs : int
        Processes at the same time; 1 makes them in this one. On a cluster, chunks under way per gathering.
    cluster : str, optional
        Address of a Dask scheduler whose workers have this project installed.

    Raises
    ------
    InputError
        If `jobs` is below 1, or Dask is not installed.
    BusError
        If no scheduler answers.
    """
    if jobs < 1:
        raise InputError(f"expected 1 job or more, got {jobs}")
    if cluster is None and (jobs == 1 or len(tasks) < 2):
        for task in tasks:
            yield task, task.make()
        return
    with _backend(cluster):
        for first in range(0, len(tasks), _AHEAD * jobs):
            batch = tasks[first : first + _AHEAD * jobs]
            with _begun(batch, jobs) as done:
                for index, arrays in done:
                    yield batch[index], arrays


@contextlib.contextmanager
def _begun(batch: Sequence[Task], jobs: int) -> Iterator[Iterator[tuple[int, list[Force]]]]:
    """Start a batch and give what is done; what is not at the end is given up without a word."""
    from joblib import Parallel, delayed

    # A terminal sends Ctrl-C to every process: those that work shall leave it to this one to end them.
    with _ctrl_c_ignored():
        done = Parallel(n_jobs=jobs, return_as="generator_unordered")(
            delayed(_one)(index, task) for index, task in enumerate(batch)
        )
    try:
        yield done
    finally:
        with warnings.catch_warnings(action="ignore"):
            done.close()


def _one(index: int, task: Task) -> tuple[int, list[Force]]:
    return index, task.make()


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
        raise BusError(f"no Dask scheduler answers at '{cluster}': {error or type(error).__name__}") from error
