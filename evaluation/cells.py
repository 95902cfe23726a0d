"""Many independent measurements: in parallel, with progress, and kept so that an interrupted run goes on."""

import hashlib
import json
import sys
from collections.abc import Callable, Sequence
from contextlib import closing
from functools import cache, partial
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from evaluation.findings import Options, Row
from skin.errors import InputError, RunError
from skin.parallel import in_parallel

#: Rooms whose code decides a result: a kept cell counts only while they are as they were.
_ROOMS: Final = ("skin", "dbc", "bandwidth", "bus", "nodes", "reconstructor", "classifier", "touch", "evaluation")
_LIBRARIES: Final = ("numpy", "scipy", "numba", "scikit-learn", "PyWavelets")


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

    Raises
    ------
    InputError
        If the folder for results cannot be read or made.
    RunError
        If a result cannot be written there.
    """
    kept = _Kept(options.out, what)
    keys = [_key(measure, cell) for cell in cells]
    missing = [index for index, key in enumerate(keys) if key not in kept.results]
    console = Console(file=sys.stderr)
    columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task(what, total=len(cells), completed=len(cells) - len(missing))
        calls = [partial(_one, measure, cells[index]) for index in missing]
        with closing(in_parallel(calls, jobs or options.jobs)) as work:
            for place, result in work:
                kept.add(keys[missing[place]], cells[missing[place]], result)
                progress.advance(task)
    return [kept.results[key] for key in keys]


def _one(measure: Callable[..., Row], cell: Row) -> Row:
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1):
        return measure(**cell)


class _Kept:
    """Results of cells, in a file with a line each where a folder is given."""

    def __init__(self, folder: Path | None, what: str) -> None:
        self.results: dict[str, Row] = {}
        self._path = folder / f"{what}.jsonl" if folder else None
        if self._path is None:
            return
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            lines = self._path.read_text(encoding="utf-8", errors="replace").splitlines() if self._path.exists() else []
        except OSError as error:
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
            line = json.dumps({"key": key, "cell": cell, "result": result})
            try:
                with self._path.open("a", encoding="utf-8") as file:
                    # Before and not behind each line, so that one that was cut short does not swallow the next.
                    file.write(line if file.tell() == 0 else f"\n{line}")
            except OSError as error:
                raise RunError(f"'{self._path}' cannot be written: {error.strerror or error}") from error


def _key(measure: Callable[..., Row], cell: Row) -> str:
    named = json.dumps([measure.__module__, measure.__qualname__, cell, _code()], sort_keys=True, default=str)
    return hashlib.sha256(named.encode()).hexdigest()


@cache
def _code() -> str:
    """Return a digest of our own source and of the libraries' versions: a result of other code is not this code's."""
    digest = hashlib.sha256(" ".join(map(version, _LIBRARIES)).encode())
    for room in _ROOMS:
        spec = find_spec(room)
        for folder in (spec.submodule_search_locations or []) if spec else []:
            for path in sorted(Path(folder).rglob("*.py")):
                digest.update(path.read_bytes())
    return digest.hexdigest()
