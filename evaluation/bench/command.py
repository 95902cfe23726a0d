"""``skin bench``: the engine measured, and measured against others."""

from importlib import import_module
from typing import Any, Final, Literal, get_args

from canskin.errors import InputError
from shell.terminal import Json, print_json, print_table, progress

Subject = Literal["reconstruct", "gateway", "chain", "classify"]
_MODULES: Final = {subject: f"evaluation.bench.{subject}" for subject in get_args(Subject)}


def bench(
    subject: Subject,
    *,
    rounds: int | None = None,
    json: Json = False,
) -> None:
    """Measure one part of the system and print a table.

    ``reconstruct`` solves one problem with our solver, with the paper's dense FISTA and with every peer of the extra
    ``bench`` that is installed, in turn and on one thread: median milliseconds of 20 iterations from a warm start, the
    gap (F - F*) / F* each is left with, the PSNR, and the ratio to ours of the same precision; then the same for the
    contourlet; then total variation on the default skin as a grid and as a graph, and on triangles. ``gateway`` gives
    the frames per second that one core takes from the socket to a complete measurement, against python-can and canopen.
    ``chain`` runs the default and the stepped skin on virtual buses and gives the processor time of each process and
    the time of each step until an image. ``classify`` times one decision between 16 objects against scikit-learn's on
    the same machines.

    Parameters
    ----------
    subject
        What to measure.
    rounds
        Times each method runs after the first, default 8; of ``chain``, runs of 10 s, default 2.
    json
        Print JSON instead of tables.

    Examples
    --------
    skin bench reconstruct
    skin bench gateway --json
    """
    count = (2 if subject == "chain" else 8) if rounds is None else rounds
    if count < 1:
        raise InputError(f"expected 1 round or more, got {count}")
    with progress(f"measuring {subject}", None):
        result: dict[str, Any] = import_module(_MODULES[subject]).run(count)
    if json:
        print_json(result)
        return
    for name, found in result.items():
        rows = found if isinstance(found, list) else [found]
        cells = [[f"{value:.4g}" if isinstance(value, float) else value for value in row.values()] for row in rows]
        print_table(list(rows[0]), cells, title=name)
        print()
