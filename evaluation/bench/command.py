"""``skin bench``: the engine measured, and measured against others."""

from importlib import import_module
from pathlib import Path
from typing import Any, Final, Literal, get_args

from canskin.errors import InputError
from reconstructor.settings import Device, LibraryName
from shell.output import check_picture_path
from shell.terminal import Json, print_json, print_table, progress

Subject = Literal["reconstruct", "images", "missing", "skins", "classify", "gateway", "chain", "ros2"]
_MODULES: Final = {subject: f"evaluation.bench.{subject}" for subject in get_args(Subject)}


def bench(
    subject: Subject,
    *,
    rounds: int | None = None,
    meshes: Path | None = None,
    figure: Path | None = None,
    device: Device | None = None,
    library: LibraryName | None = None,
    json: Json = False,
) -> None:
    """Measure one part of the system and print a table.

    ``reconstruct`` solves one problem with our solver, with the paper's dense FISTA and with every peer of the extra
    ``bench`` that is installed, in turn and on one thread: median milliseconds of 20 iterations from a warm start,
    the gap (F - F*) / F* each is left with, the PSNR, and the ratio to ours of the same precision; then the same for
    the contourlet; then total variation on the default skin as a grid and as a graph, and on triangles. With
    ``--device`` it times the solvers on arrays in place of these, on batches and on a recording: µs of an image, and
    the compiled solver's time / this time. ``images``
    gives the PSNR of every solver on the paper's five objects, at its speed of motion and ten times faster.
    ``missing`` gives it with dead nodes and with lost frames. ``skins`` times one cycle of several
    skins in one process, each with its own Φ, on one thread and on more. ``classify`` times one decision between 16
    objects against scikit-learn's on the same machines. ``gateway`` gives the frames per second that one core takes
    from the socket to a complete measurement, against python-can and canopen. ``chain`` runs the default and the
    adaptive skin on virtual buses and gives the processor time of each process and the time of each step until an
    image. ``ros2`` gives the time from an image on the fabric to the image at a reader on ROS 2.

    Parameters
    ----------
    subject
        What to measure.
    rounds
        Times each method runs after the first; of ``missing``, draws of what is missing; of ``chain``, runs of 10 s.
        Default 8, 2 and 2. ``images`` has none.
    meshes
        Folder of meshes (cup, drill, largeclamp) in place of the shapes that ship, for ``images``.
    figure
        File for the curves of ``missing``: .svg, .png or .pdf.
    device
        Of ``reconstruct``: where arrays are solved. ``cpu`` only checks the code.
    library
        Of ``--device``; default: of a GPU CuPy, else PyTorch; of the CPU NumPy.
    json
        Print JSON instead of tables.

    Examples
    --------
    skin bench reconstruct
    skin bench reconstruct --device gpu --library torch
    skin bench images --meshes ycb-meshes
    skin bench missing --json --figure missing-data.svg
    """
    if figure is not None:  # before minutes are spent on its curves
        if subject != "missing":
            raise InputError(f"only 'missing' has a figure, not '{subject}'")
        check_picture_path(figure)
    arguments = _arguments(subject, rounds, meshes)
    module = import_module(_MODULES[subject])
    if device is not None or library is not None:
        if subject != "reconstruct" or device is None:
            raise InputError("--device is of 'reconstruct', and --library of --device: leave them out")
        module = import_module("evaluation.bench.arrays")
        arguments |= {"device": device, "library": library}
    with progress(f"measuring {subject}", None):
        result: dict[str, Any] = module.run(**arguments)
    if figure is not None:
        module.draw(result, figure)
    if json:
        print_json(result)
        return
    for name, found in result.items():
        rows = found if isinstance(found, list) else [found]
        cells = [[f"{value:.4g}" if isinstance(value, float) else value for value in row.values()] for row in rows]
        print_table(list(rows[0]), cells, title=name)
        print()


def _arguments(subject: str, rounds: int | None, meshes: Path | None) -> dict[str, Any]:
    """Return the arguments of the subject's ``run``; raise InputError for an option it does not have."""
    if subject == "images":
        if rounds is not None:
            raise InputError(f"'images' looks at every frame once, got {rounds} rounds: leave out --rounds")
        if meshes is not None and not meshes.is_dir():
            raise InputError(f"no folder '{meshes}': expected a folder of meshes")
        return {"meshes": meshes}
    if meshes is not None:
        raise InputError(f"only 'images' takes meshes, not '{subject}': leave out --meshes")
    count = (2 if subject in {"missing", "chain"} else 8) if rounds is None else rounds
    if count < 1:
        raise InputError(f"expected 1 round or more, got {count}")
    return {"rounds": count}
