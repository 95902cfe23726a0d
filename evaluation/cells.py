"""Many independent measurements: in parallel, with progress, and kept so that an interrupted run goes on."""

import hashlib
import json
import sys
from collections.abc import Callable, Sequence
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from evaluation.findings import Options, Row
from skin.errors import InputError

#: Rooms whose code decides a result: a kept cell counts only while they are as they were.
_ROOMS: Final = ("skin", "dbc", "bandwidth", "reconstructor", "classifier", "touch", "evaluation")


def measure_cells(
    measure: Callable[..., Row], cells: Sequence[Row], options: Options, what: str, *, jobs: int | None = None
) -> list[Row]:
    """Return ``measure(**cell)`` of every cell, in their order.

    Parameters
    ----------
    measure : callable
        A module's function; takes and returns what JSON can hold.
    cells : sequence of dict
        Its keyword arguments.
    options : Options
        `jobs` processes work on one thread each; with `out`, each result is kept in ``WHAT.jsonl`` there as soon as it
        is known, and not measured again while the code is the same.
    what : str
        Shown beside the progress bar, on a terminal.
    jobs : int, optional
        In place of the options', for cells whose times are measured.
    """
    kept = _Kept(options.out, what)
    keys = [_key(measure, cell) for cell in cells]
    missing = [index for index, key in enumerate(keys) if key not in kept.results]
    console = Console(file=sys.stderr)
    columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task(what, total=len(cells), completed=len(cells) - len(missing))
        for index, result in _measured(measure, cells, missing, jobs or options.jobs):
            kept.add(keys[index], cells[index], result)
            progress.advance(task)
    return [kept.results[key] for key in keys]


def _measured(measure: Callable[..., Row], cells: Sequence[Row], wanted: Sequence[int], jobs: int) -> Any:
    from joblib import Parallel, delayed, parallel_config

    if jobs == 1 or len(wanted) < 2:
        return (_one(measure, index, cells[index]) for index in wanted)
    with parallel_config(backend="loky", inner_max_num_threads=1):
        work = Parallel(n_jobs=jobs, return_as="generator_unordered")
        return work(delayed(_one)(measure, index, cells[index]) for index in wanted)


def _one(measure: Callable[..., Row], index: int, cell: Row) -> tuple[int, Row]:
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1):
        return index, measure(**cell)


class _Kept:
    """Results of cells, in a file with a line each where a folder is given."""

    def __init__(self, folder: Path | None, what: str) -> None:
        self.results: dict[str, Row] = {}
        self._path = folder / f"{what}.jsonl" if folder else None
        if self._path is None:
            return
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            lines = self._path.read_text(encoding="utf-8").splitlines() if self._path.exists() else []
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(f"'{self._path}' cannot be read or made: {error}; give another --out") from error
        for line in lines:
            self._read(line)

    def _read(self, line: str) -> None:
        try:
            kept = json.loads(line)
            self.results[kept["key"]] = dict(kept["result"])
        except (ValueError, KeyError, TypeError):
            return  # the last line of a run that was cut short: measured again

    def add(self, key: str, cell: Row, result: Row) -> None:
        """Keep one result."""
        self.results[key] = result
        if self._path is not None:
            with self._path.open("a", encoding="utf-8") as file:
                # A line that was cut short must not swallow this one.
                file.write("\n" * (file.tell() > 0) + json.dumps({"key": key, "cell": cell, "result": result}))


def _key(measure: Callable[..., Row], cell: Row) -> str:
    named = json.dumps([measure.__module__, measure.__qualname__, cell, _code()], sort_keys=True, default=str)
    return hashlib.sha256(named.encode()).hexdigest()


@cache
def _code() -> str:
    """Return a digest of our own source: a result of other code is not this code's."""
    digest = hashlib.sha256()
    for room in _ROOMS:
        spec = find_spec(room)
        for folder in (spec.submodule_search_locations or []) if spec else []:
            for path in sorted(Path(folder).rglob("*.py")):
                digest.update(path.read_bytes())
    return digest.hexdigest()
