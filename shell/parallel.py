"""Independent work in parallel: on this machine's cores, or on those of many machines."""

import contextlib
import logging
import signal
import threading
import warnings
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import CancelledError
from importlib.metadata import version
from itertools import islice
from typing import Annotated, Any, Final, TypeVar

from cyclopts import Parameter

from canskin.errors import InputError, RunError
from shell.extras import not_installed

Result = TypeVar("Result")
Call = Callable[[], Result]
#: The option of a verb that has much independent work.
Cluster = Annotated[
    str | None,
    Parameter(
        name="--cluster",
        help="Address of a scheduler of dask.distributed, whose workers do the work; see docs/recording.md.",
    ),
]
#: Longest wait for a scheduler.
PATIENCE_S: Final = 30.0


def in_parallel(
    calls: Sequence[Call[Result]], jobs: int | str, *, ahead: int | None = None
) -> Generator[tuple[int, Result]]:
    """Yield the index and the result of each call, in the order of completion.

    Parameters
    ----------
    calls : sequence of callable
        Called without arguments; calls and results must be picklable.
    jobs : int or str
        Number of processes, each with one thread; 1 uses this process. Or the address of a scheduler of
        dask.distributed: the calls of a worker that dies are made again by others.
    ahead : int, optional
        Calls per job that run before their results are yielded, to limit the memory of large results; default: all.

    Raises
    ------
    InputError
        If there is no job, distributed is missing, or a worker has another version of canskin.
    RunError
        If no scheduler answers, it has no workers or is lost, or a call has killed several of them.
    """
    if isinstance(jobs, str):
        yield from _on_cluster(calls, jobs, ahead)
        return
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


def _on_cluster(calls: Sequence[Call[Result]], address: str, ahead: int | None) -> Iterator[tuple[int, Result]]:
    dask = _dask()
    try:
        client = dask.Client(address, timeout=PATIENCE_S)
    except (OSError, ValueError) as error:
        raise RunError(f"--cluster {address}: no scheduler answers: is 'dask scheduler' running there?") from error
    with client:
        own, versions = version("canskin"), client.run(version, "canskin", on_error="return")
        if not versions:
            raise RunError(f"--cluster {address}: the scheduler has no workers: 'dask worker {address} --nthreads 1'")
        if others := {worker: each for worker, each in versions.items() if each != own}:
            worker, other = others.popitem()
            raise InputError(f"--cluster {address}: {worker}: expected canskin {own}, got {other}: install one version")
        left, places, done = iter(enumerate(calls)), dict[object, int](), dask.as_completed()

        def begin(number: int | None) -> None:
            for place, call in islice(left, number):
                future = client.submit(call, pure=False)
                places[future.key] = place
                done.add(future)

        begin(None if ahead is None else ahead * len(versions))
        for future in done:
            try:
                yield places.pop(future.key), future.result()
            except dask.KilledWorker as error:
                raise RunError(f"--cluster {address}: a call has ended several workers: {error}") from error
            except CancelledError as error:
                raise RunError(f"--cluster {address}: the scheduler is lost") from error
            begin(1)


def _dask() -> Any:
    """Return dask.distributed, whose classes have no types; a lost scheduler is logged without its tracebacks."""
    try:
        import distributed
    except ImportError as error:
        raise not_installed("--cluster needs distributed", "cluster") from error
    for name in ("client", "utils"):
        logging.getLogger(f"distributed.{name}").setLevel(logging.CRITICAL)
    return distributed


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
