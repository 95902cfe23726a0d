"""``skin layout``: makes and explains a layout, lists its settings, and draws its boards."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt
import tomli_w

from bandwidth.plan import planned
from bandwidth.settings import Setting, settings
from bandwidth.traffic import Disturbance
from bandwidth.wiring import wiring
from canskin.errors import InputError
from dbc.contract import Contract
from shell.neighbours import new_serial, require_new, tell_shared
from shell.output import PICTURE_SUFFIXES, check_new_path, check_output_path, save_figure, write_file
from shell.service import say
from shell.terminal import Json, print_json, print_table
from skin.chains import positions_text
from skin.choice import BUSES_MAX, chosen
from skin.importing import new_name, tables_of
from skin.layout import Layout, layout_tables, load_layout, parse_layout
from skin.matrix import MatrixPhi
from skin.phi import Sbhe
from skin.plane import Plane
from skin.surface import Surface
from skin.ways_of_sending import SendingName

#: Most characters of a value in the table of settings; JSON has all.
_CHARACTERS: Final = 60
#: Pixels between neighbours in the picture of a skin that is no grid.
_SCALE: Final = 16


def layout(
    action: Literal["new", "check", "settings", "draw"],
    file: Path | None = None,
    *,
    out: Path | None = None,
    ini: Path | None = None,
    sending: SendingName = "synchronous",
    json_: Json = False,
) -> int:
    """Make a layout, explain it, list its settings, or draw which taxels each board has.

    Parameters
    ----------
    action
        ``new``: make a layout of taxels. ``check``: read the layout, name its first error, or print what it says.
        ``settings``: print the value of every key, and where the value comes from. ``draw``: write a picture of the
        boards, each in a colour, with the order of their taxels.
    file
        TOML or recording (.mcap) of the skin; without it the default skin. For ``new`` the taxels: 24x32, or a file:
        .csv of positions, .txt of an iCub's skin, .urdf with tactile sensors.
    out
        ``draw``: file of the picture; default: the name of the skin, .png. ``new``: TOML to write; taxels at positions
        are written to a .csv beside it.
    ini
        ``new``: the .ini of an iCub's part, which names the modules.
    sending
        ``new``: sums in each cycle, or whenever they carry news.
    json_
        Print one JSON object.

    Examples
    --------
    skin layout new 24x32 --sending steps --out glove.toml
    skin layout new left_forearm_mesh.txt --ini left_forearm.ini --out forearm.toml
    skin layout check palm.toml
    skin layout draw palm.toml --out palm-boards.png
    skin layout settings run.mcap
    """
    if action == "new":
        return _new(file, out, ini, sending)
    skin = load_layout(file)
    if out is not None and action != "draw":
        raise InputError("--out is for 'skin layout new' and 'skin layout draw': leave it out")
    if action == "settings":
        return _print_settings(settings(skin, *layout_tables(file)), as_json=json_)
    Contract.from_layout(skin)  # refuses what its buses cannot have
    about = _about(skin, file)
    if action == "draw":
        about["picture"] = str(_draw(skin, out or Path(f"{skin.name}.png")))
    if json_:
        print_json(about)
    else:
        print_table((), [(name.replace("_", " "), _words(value)) for name, value in about.items()])
    return 0


def _new(taxels: Path | None, out: Path | None, modules: Path | None, sending: SendingName) -> int:
    if taxels is None:
        raise InputError("expected the taxels: 24x32, or a file of positions (.csv, .txt of an iCub's skin, .urdf)")
    if out is not None:
        check_new_path(out, "layout", ".toml")
    tables, told = tables_of(str(taxels), modules)
    for words in told:
        say("layout", words)
    name = new_name(str(taxels), out)
    require_new(name)
    tables = {"name": name, "sending": sending, "device": {"first_serial": new_serial(name)}, **tables}
    if sending == "steps":
        tables.setdefault("measurement", {"wiring": "board"})
    skin = parse_layout(tomli_w.dumps(tables).encode(), str(taxels))
    tell_shared(skin, "layout")
    if skin.sends.in_cycles:
        _complete(tables, skin)
    if out is not None and skin.taxels.positions is not None:
        tables["taxels"]["positions"] = _beside(taxels, out, skin)
        if skin.measurement.chains is not None:  # the file of positions has them
            del tables["measurement"]["wiring"], tables["measurement"]["chains"]
    text = tomli_w.dumps(tables)
    if out is None:
        print(text, end="")
        return 0
    write_file(out, text.encode())
    print_table((), [(key.replace("_", " "), _words(value)) for key, value in _about(load_layout(out), out).items()])
    return 0


def _complete(tables: dict[str, Any], skin: Layout) -> None:
    """Write what was chosen for a skin that sends in cycles into its tables, and say why."""
    for words in chosen(skin, tables):
        say("layout", words)
    if any(each.problems for each in planned(skin, Disturbance())):
        say("layout", f"no {BUSES_MAX} buses carry its sums at {skin.sync.rate_hz:g} Hz: see skin plan --taxels")
    tables.setdefault("measurement", {})["sums"] = skin.measurement.sums
    tables["sampling"] = {"rate_hz": skin.samples_per_sync * skin.sync.rate_hz}
    tables["bus"] = [{"name": bus.name, "nodes": bus.nodes} for bus in skin.bus]


def _beside(taxels: Path, out: Path, skin: Layout) -> str:
    """Return the path of the positions as the layout names it: of the user's own file, or of a file that is written."""
    if taxels.suffix.lower() == ".csv":
        return os.path.relpath(taxels, out.parent)
    beside = out.with_suffix(".csv")
    check_new_path(beside, "positions", ".csv")
    write_file(beside, positions_text(skin.taxels.surface, skin.measurement.chains).encode())
    return beside.name


def _print_settings(found: Sequence[Setting], *, as_json: bool) -> int:
    if as_json:
        print_json([each._asdict() for each in found])
    else:
        print_table(["setting", "value", "from"], ((each.key, _short(each.value), each.origin) for each in found))
    return 0


def _short(value: Any) -> str:
    text = str(value)
    return text if len(text) <= _CHARACTERS else f"{text[:_CHARACTERS]}..."


def _about(skin: Layout, path: Path | None) -> dict[str, Any]:
    phi = skin.operator()
    return {
        "skin": skin.name,
        "sending": skin.sending,
        "rows": skin.taxels.rows,
        "columns": skin.taxels.columns,
        "taxels": skin.taxels.there,
        **_about_others(skin),
        **(_about_matrix(phi) if isinstance(phi, MatrixPhi) else _about_boards(skin, phi)),
        "sums": phi.shape[0],
        "sums_per_taxel": round(phi.shape[0] / skin.taxels.there, 3),
        **({"chosen": words} if (words := chosen(skin, layout_tables(path)[0])) else {}),
        "fingerprint": phi.fingerprint,
    }


def _about_others(skin: Layout) -> dict[str, Any]:
    """Count the messages of other devices, and those that no plan has."""
    others = [each for bus in skin.bus for each in bus.foreign]
    split = (
        f", {count} of more than 8 bytes (J1939), no part of a plan"
        if (count := sum(each.is_split for each in others))
        else ""
    )
    return {"foreign_messages": f"{len(others)}{split}"} if others else {}


def _about_boards(skin: Layout, phi: Sbhe) -> dict[str, Any]:
    return {
        "blocks": phi.blocks,
        "taxels_of_a_block": sorted({int(phi.held.min()), int(phi.held.max())}),
        "empty_places": phi.empty,
        "nodes": {bus.name: bus.nodes for bus in skin.bus},
        "wires": str(wiring(skin)),
    }


def _about_matrix(phi: MatrixPhi) -> dict[str, Any]:
    felt = np.count_nonzero(phi.entries, axis=2)
    unfelt = int((phi.is_wired & ~phi.entries.any(axis=(0, 1))).sum())
    return {
        "matrices": phi.frames,
        "taxels_of_a_sum": sorted({int(felt.min()), int(felt.max())}),
        "taxels_that_no_sum_feels": unfelt,
    }


def _words(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{name}: {each}" for name, each in value.items())
    if isinstance(value, list):
        return ("; " if isinstance(value[0], str) else " to ").join(map(str, value))
    return str(value)


def _draw(skin: Layout, path: Path) -> Path:
    """Draw the boards in their colours; the number at a taxel is its place in the chain. Curved skins in space, too."""
    from matplotlib import colormaps
    from matplotlib.figure import Figure

    check_output_path(path, "picture", *PICTURE_SUFFIXES)
    phi, surface = skin.phi(), skin.taxels.surface
    plane, scale = Plane(surface), 1 if surface.is_grid else _SCALE
    # Neighbouring numbers get colours far apart.
    colours = colormaps["hsv"](phi.block_of_taxel * 0.618034 % 1.0, alpha=np.where(phi.is_wired, 0.55, 0.0))
    width = min(24.0, max(4.0, plane.width * 0.25))
    height = max(2.0, width * plane.height / plane.width) + 0.8
    is_curved = not surface.is_flat
    figure = Figure(figsize=(width, height + is_curved * width), layout="constrained")
    grid = figure.add_gridspec(1 + is_curved, 1, height_ratios=(height, width)[: 1 + is_curved])
    axes = figure.add_subplot(grid[0])
    cells = np.append(colours, np.zeros((1, 4)), axis=0)[plane.cells(scale)]
    axes.imshow(cells, interpolation="nearest", extent=(0, plane.width, plane.height, 0))
    place = phi.place_of_taxel % phi.block_size
    size = min(8.0, 72 * width / plane.width / 3)
    for taxel in np.flatnonzero(phi.is_wired).tolist():
        x, y = plane.places[taxel]
        axes.text(x, y, str(place[taxel]), ha="center", va="center", fontsize=size)
    for each in range(phi.blocks):
        if skin.measurement.wiring != "scattered":
            axes.plot(*plane.places[phi.taxels_of(each)].T, color="black", linewidth=0.4, alpha=0.5)
    axes.set_title(f"{skin.name}: {phi.blocks} blocks, {phi.empty} empty places", fontsize=10)
    axes.set(xticks=[], yticks=[])
    if is_curved:
        _draw_in_space(figure.add_subplot(grid[1], projection="3d"), surface, colours)
    save_figure(figure, path, dpi=110)
    return path


def _draw_in_space(axes: Any, surface: Surface, colours: npt.NDArray[np.floating]) -> None:
    places_mm = 1e3 * surface.positions_m
    axes.scatter(*places_mm.T, c=colours, depthshade=False)
    axes.set_box_aspect(np.maximum(np.ptp(places_mm, axis=0), 1e3 * surface.pitch_m), zoom=0.85)
    axes.set(xlabel="x, mm", ylabel="y, mm", zlabel="z, mm")
