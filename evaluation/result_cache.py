"""Independent measurements: in parallel, with progress, and kept so that a run that was cut short goes on."""

import hashlib
from collections.abc import Callable, Sequence
from contextlib import closing
from functools import cache, partial
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

from joblib import Memory
from threadpoolctl import threadpool_limits

from canskin.errors import InputError
from evaluation.result import Options, Row
from shell.parallel import in_parallel
from shell.service import say
from shell.terminal import progress

#: Folders and libraries that decide a result: a kept result counts only while they are as they were.
_FOLDERS: Final = (
    "skin",
    "calibration",
    "dbc",
    "bandwidth",
    "bus",
    "nodes",
    "gateway",
    "reconstructor",
    "classifier",
    "touch",
    "demo",
    "evaluation",
)
LIBRARIES: Final = ("numpy", "scipy", "numba", "scikit-learn", "PyWavelets")


def measure_cells(
    measure: Callable[..., Row], cells: Sequence[Row], options: Options, what: str, *, jobs: int | None = None
) -> list[Row]:
    """Return ``measure(**cell)`` of every cell, in their order.

    Parameters
    ----------
    measure : callable
        A module's function.
    cells : sequence of dict
        Its keyword arguments.
    options : Options
        `jobs` processes work on one thread each. With `out`, joblib keeps each result in ``out/results`` as soon as
        the result is known, and no cell is measured again while the code and the libraries are the same.
    what : str
        Said when the work begins, and shown beside the progress bar, on a terminal.
    jobs : int, optional
        In place of the options', for cells whose times are measured.
    """
    known = _remembering(measure, options.out)
    missing = [place for place, cell in enumerate(cells) if not (options.out and known.check_call_in_cache(**cell))]
    say("evaluate", f"{what}, {len(missing)} of {len(cells)} cells to measure")
    measured: dict[int, Row] = {}
    with progress(what, len(cells), done=len(cells) - len(missing)) as bar:
        calls = [partial(_on_one_thread, known, cells[place]) for place in missing]
        with closing(in_parallel(calls, jobs or options.jobs)) as work:
            for number, result in work:
                measured[missing[number]] = result
                bar.advance()
    return [measured[place] if place in measured else known(**cell) for place, cell in enumerate(cells)]


def measured_rows(measure: Callable[..., Row], cells: Sequence[Row], options: Options, what: str) -> list[Row]:
    """Return every cell together with what `measure_cells` finds for it."""
    return [cell | found for cell, found in zip(cells, measure_cells(measure, cells, options, what), strict=True)]


def _on_one_thread(known: Callable[..., Row], cell: Row) -> Row:
    with threadpool_limits(1):
        return known(**cell)


def _remembering(measure: Callable[..., Row], folder: Path | None) -> Any:
    """Return `measure` with a memory in a folder; results of other code lie in another."""
    if folder is None:
        return measure
    place = folder / "results" / code_digest()
    try:
        place.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"'{place}' cannot be made: {error}; give another --out") from error
    return Memory(place, verbose=0).cache(measure)


@cache
def code_digest() -> str:
    """Return a digest of our own source and of the libraries' versions."""
    digest = hashlib.sha256(" ".join(map(version, LIBRARIES)).encode())
    for name in _FOLDERS:
        spec = find_spec(name)
        for folder in (spec.submodule_search_locations or []) if spec else []:
            for path in sorted(Path(folder).rglob("*.py")):
                digest.update(path.read_bytes())
    return digest.hexdigest()[:16]
