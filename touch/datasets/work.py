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
            with contextlib.closing(_begun(batch, jobs)) as done:
                for index, arrays in done:
                    yield batch[index], arrays


def _begun(batch: Sequence[Task], jobs: int) -> Generator[tuple[int, list[Force]]]:
    """Start a batch and yield what is done; what is not when nobody asks any more is given up without a word."""
    from joblib import Parallel, delayed

    with _children_deaf_to_ctrl_c():
        done = Parallel(n_jobs=jobs, return_as="generator_unordered")(
            delayed(_one)(index, task) for index, task in enumerate(batch)
        )
    try:
        yield from done
    finally:
        with warnings.catch_warnings(action="ignore"):
            done.close()


def _one(index: int, task: Task) -> tuple[int, list[Force]]:
    return index, task.make()


@contextlib.contextmanager
def _children_deaf_to_ctrl_c() -> Iterator[None]:
    """Have processes that start inside ignore SIGINT, which a terminal sends to all: this one ends them."""
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

    if cluster is None:
        with parallel_config(backend="loky", inner_max_num_threads=1):
            yield
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
