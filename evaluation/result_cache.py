"""Independent measurements: in parallel, with progress, and kept so that a run that was cut short goes on."""

import hashlib
from collections.abc import Callable, Sequence
from contextlib import closing
from functools import cache, partial
from importlib.metadata import version
from importlib.util import find_spec
from operator import methodcaller
from pathlib import Path
from typing import Final

import joblib
import msgspec
from threadpoolctl import threadpool_limits

from canskin.errors import UNDECODABLE, InputError
from evaluation.result import Options, Row
from shell.output import write_file
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
        `jobs` processes work on one thread each. With `out`, each result is kept in ``out/results`` as soon as it
        is known, and no cell is measured again while the code and the libraries are the same.
    what : str
        Said when the work begins, and shown beside the progress bar, on a terminal.
    jobs : int, optional
        In place of the options', for cells whose times are measured.

    Returns
    -------
    list of dict
        With lists in place of tuples and arrays, as a file keeps them.
    """
    folder = _folder(options.out) if options.out else None
    paths = [
        folder / f"{measure.__name__}-{joblib.hash((measure.__module__, each))}" if folder else None for each in cells
    ]
    found = {place: row for place, path in enumerate(paths) if path and (row := _kept(path)) is not None}
    missing = [place for place in range(len(cells)) if place not in found]
    say("evaluate", f"{what}, {len(missing)} of {len(cells)} cells to measure")
    with progress(what, len(cells), done=len(found)) as bar:
        calls = [partial(_measured, measure, cells[place], paths[place]) for place in missing]
        with closing(in_parallel(calls, jobs or options.jobs)) as work:
            for number, row in work:
                found[missing[number]] = row
                bar.advance()
    return [found[place] for place in range(len(cells))]


def measured_rows(measure: Callable[..., Row], cells: Sequence[Row], options: Options, what: str) -> list[Row]:
    """Return every cell together with what `measure_cells` finds for it."""
    return [cell | found for cell, found in zip(cells, measure_cells(measure, cells, options, what), strict=True)]


def _measured(measure: Callable[..., Row], cell: Row, path: Path | None) -> Row:
    """Return ``measure(**cell)``, measured on one thread, and keep it at `path`."""
    with threadpool_limits(1):
        row = measure(**cell)
    content = msgspec.msgpack.encode(row, enc_hook=methodcaller("tolist"))  # of NumPy
    if path:
        write_file(path, content)
    return msgspec.msgpack.decode(content, type=Row)


def _kept(path: Path) -> Row | None:
    """Return the row that `path` keeps; None if there is none that can be read."""
    try:
        return msgspec.msgpack.decode(path.read_bytes(), type=Row)
    except (OSError, *UNDECODABLE):
        return None


def _folder(out: Path) -> Path:
    """Return the folder of what this code finds; results of other code lie in another."""
    place = out / "results" / code_digest()
    try:
        place.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"'{place}' cannot be made: {error}; give another --out") from error
    return place


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
