"""``skin touch objects``."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from shell.terminal import Json, print_json, print_table
from touch.contact import Force


def objects(*names: str, meshes: Path | None = None, figure: Path | None = None, json: Json = False) -> None:
    """List and draw the objects that can touch the simulated skin.

    The figures are for the object in the middle of a skin of 64 x 64 taxels, 4 mm apart, pressed in by 9.99 mm, the
    depth of the paper's data.

    Parameters
    ----------
    names
        List only these objects, and draw each below the table; with spaces or commas. FILE@UNIT is your own mesh.
    meshes
        Folder of meshes (banana, cup, drill, largeclamp, mustard) to use in place of our own shapes.
    figure
        File for a picture with the tactile image of every listed object, for example .png.
    json
        Print one JSON array instead of a table and drawings.

    Examples
    --------
    skin touch objects
    skin touch objects drill,cup --meshes ycb-meshes
    skin touch objects handle.stl@mm:y90
    skin touch objects --figure objects.png
    skin touch objects --json | jq 'max_by(.contact_taxels).name'
    """
    from shell.output import PICTURE_SUFFIXES, check_output_path
    from touch.drawing import as_text, save_images
    from touch.objects import CATALOGUE, checked_names

    if figure is not None:
        check_output_path(figure, "picture", *PICTURE_SUFFIXES)
    images = _press_each(checked_names(names) if names else tuple(CATALOGUE), meshes)
    rows = [_describe(name, meshes, force_n) for name, force_n in images.items()]
    if json:
        print_json(rows)
    else:
        _print_table(rows)
        for name in images if names else ():
            print(f"\n{name}\n{as_text(images[name])}")
    if figure is not None:
        save_images(images, figure)


def _press_each(names: Sequence[str], meshes: Path | None) -> dict[str, Force]:
    from touch.contact import Grid, Pose, press
    from touch.objects import spheres_of
    from touch.trajectory import PAPER_DEPTH_M

    middle = Pose(0.0, 0.0, 0.0, PAPER_DEPTH_M)
    return {name: press(Grid(), [(spheres_of(name, meshes), middle)]) for name in names}


def _describe(name: str, meshes: Path | None, force_n: Force) -> dict[str, Any]:
    from skin.sources import object_label
    from touch.objects import made_of, size_m, spheres_of

    length_m, width_m = size_m(name, meshes)
    return {
        "name": object_label(name),
        "made_of": made_of(name, meshes),
        "length_m": length_m,
        "width_m": width_m,
        "spheres": len(spheres_of(name, meshes)),
        "contact_taxels": int((force_n > 0).sum()),
        "peak_force_n": round(float(force_n.max()), 6),
        "total_force_n": round(float(force_n.sum(dtype=float)), 6),
    }


def _print_table(rows: Sequence[dict[str, Any]]) -> None:
    cells = [
        (
            row["name"],
            row["made_of"],
            f"{row['length_m'] * 1e3:.0f} x {row['width_m'] * 1e3:.0f}",
            row["spheres"],
            row["contact_taxels"],
            f"{row['total_force_n'] * 1e3:.0f}",
        )
        for row in rows
    ]
    print_table(("object", "made of", "size mm", "spheres", "taxels", "force mN"), cells)
