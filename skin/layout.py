"""The layout of one skin in one TOML file, read and written; for all rooms, with its tables (`skin.layout_keys`)."""

import contextlib
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

import msgspec
import tomli_w

from canskin.errors import InputError, LayoutError
from recording import is_recording
from skin.chains import read_chains, read_positions
from skin.choice import BUSES_MAX, averaged_hz, carried_sums, carries_enough
from skin.foreign import with_foreign_dbc
from skin.layout_checks import check
from skin.layout_keys import (
    BITRATE_MAX,
    BITRATE_MIN,
    BOARD_MAX,
    DATA_BITRATE_MAX,
    GAP,
    NAME_CHARACTERS,
    RATE_MAX_HZ,
    SUM_BITS_MAX,
    SUM_BITS_MIN,
    TAXEL,
    Bus,
    Device,
    Encoding,
    Layout,
    PhiParameters,
    Region,
    Sampling,
    Steps,
    Sync,
    Taxels,
    blocks_of,
    changed,
    require_boards,
    require_sending,
)
from skin.limits import decode_toml, read_file
from skin.matrix import read_matrix
from skin.toml_errors import in_words
from skin.ways_of_sending import BUS_SUMS, IN_CYCLES, SENDINGS

__all__ = [
    "BITRATE_MAX",
    "BITRATE_MIN",
    "DATA_BITRATE_MAX",
    "GAP",
    "NAME_CHARACTERS",
    "RATE_MAX_HZ",
    "SHIPPED",
    "SUM_BITS_MAX",
    "SUM_BITS_MIN",
    "TAXEL",
    "Bus",
    "Device",
    "Encoding",
    "Layout",
    "PhiParameters",
    "Region",
    "Sampling",
    "Steps",
    "Sync",
    "Taxels",
    "changed",
    "layout_tables",
    "layout_text",
    "load_layout",
    "parse_layout",
    "require_boards",
    "require_sending",
    "validated",
]

#: Names of the layouts that come with the project.
SHIPPED: Final = tuple(
    sorted(Path(each.name).stem for each in files("skin.layouts").iterdir() if each.name.endswith(".toml"))
)

#: Suffixes of files of taxels, of which `skin.importing` makes layouts.
TAXEL_FILES: Final = (".csv", ".txt", ".urdf")
#: Fewest places of a block of a board that exists, if `block_size` is not given; else the power of two that holds it.
BOARD_MIN: Final = 8
#: Default: the smallest number of buses with at most this number of nodes, each of one block, and identifiers for all.
NODES_PER_BUS: Final = 32


def load_layout(path: Path | None = None) -> Layout:
    """Read a layout: a file, that of a recording, or one of `SHIPPED` by its bare name; without a path, the default."""
    name = "default" if path is None else str(path)
    return parse_layout(*_read(path, name), is_whole=is_recording(path))


def _read(path: Path | None, name: str) -> tuple[bytes, str, Path]:
    """Return content and origin of a layout, and the folder of the files that it names."""
    if path is None or (name in SHIPPED and not path.is_file()):
        folder = files("skin.layouts")
        return folder.joinpath(f"{name}.toml").read_bytes(), f"{name}.toml", Path(str(folder))
    if is_recording(path):
        return _read_attached(path), name, path.parent
    if not path.suffix and not path.exists():
        raise LayoutError(f"{path}: no such file, and no layout of canskin: expected {', '.join(SHIPPED)}, or a file")
    if path.suffix.lower() in TAXEL_FILES and path.is_file():
        raise LayoutError(f"{path}: is a file of taxels: make a layout of it with 'skin layout new {path} --out FILE'")
    return read_file(path, LayoutError, "the layout"), name, path.parent


def _read_attached(path: Path) -> bytes:
    """Return the layout in a recording."""
    from recording.mcap_file import LAYOUT_FILE, read_about

    try:
        content = read_about(path).files.get(LAYOUT_FILE)
    except InputError as error:
        raise LayoutError(str(error)) from error
    if content is None:
        raise LayoutError(f"{path}: this recording has no layout, or a damaged one: give the layout's own file")
    return content


def layout_tables(path: Path | None) -> tuple[dict[str, Any], str]:
    """Return what the file of a layout says, without any default, and the file's name; a path as `load_layout` takes.

    Only for a layout that `load_layout` has read.
    """
    content, origin, _ = _read(path, "default" if path is None else str(path))
    return decode_toml(content, origin), origin


def parse_layout(content: bytes, origin: str, folder: Path = Path(), *, is_whole: bool = False) -> Layout:
    """Decode and check a layout; `origin` names the file in messages, and `folder` holds the files that it names.

    With `is_whole` the content is that of `layout_text`, perhaps of an older version: no rate of samples is chosen.
    """
    document = _with_devices(_with_files(_with_shape(decode_toml(content, origin)), folder), folder)
    document = _with_sizes(document, is_whole=is_whole)
    try:
        layout = msgspec.convert(document, Layout)
    except msgspec.ValidationError as error:
        raise LayoutError(f"{origin}: {in_words(str(error), document, Layout)}") from error
    try:
        check(layout, has_steps="steps" in document and not is_whole)
    except LayoutError as error:
        raise LayoutError(f"{origin}: {error}") from error
    return layout


def _with_shape(tables: dict[str, Any]) -> dict[str, Any]:
    """Fill in rows and columns of a shape."""
    taxels = tables.get("taxels")
    shape = taxels.get("shape") if isinstance(taxels, dict) else None
    if isinstance(shape, list) and shape and isinstance(shape[0], str):
        tables["taxels"] = {"rows": len(shape), "columns": len(shape[0])} | tables["taxels"]
    return tables


def _with_files(tables: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Read the files of positions and chains beside a layout, if named: the layout then stands for itself."""
    taxels, measurement = tables.get("taxels", {}), tables.get("measurement", {})
    if not isinstance(taxels, dict) or not isinstance(measurement, dict):
        return tables
    if isinstance(taxels.get("positions"), str):
        taxels["positions"], chains = read_positions(folder / taxels["positions"])
        if chains is not None and "matrix" not in measurement:
            measurement = tables["measurement"] = {"wiring": "file", "chains": chains} | measurement
    if isinstance(measurement.get("matrix"), str):
        measurement["matrix"] = read_matrix(folder / measurement["matrix"])
    if isinstance(matrix := measurement.get("matrix"), list) and all(isinstance(row, str) for row in matrix):
        measurement["matrix"] = [matrix]
    if isinstance(taxels.get("positions"), list):
        tables["taxels"] = {"rows": 1, "columns": len(taxels["positions"])} | taxels
    if isinstance(measurement.get("chains"), str):
        columns = tables.get("taxels", {}).get("columns", Taxels().columns)
        measurement["chains"] = read_chains(folder / measurement["chains"], columns if type(columns) is int else 0)
    if isinstance(measurement.get("chains"), list):
        most = max((len(held) for held in measurement["chains"] if isinstance(held, list)), default=0)
        measurement.setdefault("block_size", min(BOARD_MAX, max(BOARD_MIN, 1 << max(most - 1, 0).bit_length())))
    return tables


def _with_devices(tables: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Fill in the number of nodes of listed node-IDs, and the messages of other devices from their files."""
    buses = tables.get("bus")
    for bus in buses if isinstance(buses, list) else ():
        if isinstance(bus, dict):
            with_foreign_dbc(bus, folder)
            if isinstance(bus.get("node_ids"), list):
                bus.setdefault("nodes", len(bus["node_ids"]))
    return tables


def _with_sizes(tables: dict[str, Any], *, is_whole: bool) -> dict[str, Any]:
    """Fill in the defaults that depend on other keys: rates, sums, buses; see `skin.choice`."""
    sends = SENDINGS.get(str(tables.get("sending")), IN_CYCLES)
    for name, rate_hz in sends.default_rates_hz.items():
        table = tables.setdefault(name, {})
        if isinstance(table, dict):  # else the check of the whole layout names the path
            table.setdefault("rate_hz", rate_hz)
    try:
        taxels = msgspec.convert(tables.get("taxels", {}), Taxels)
        parameters = msgspec.convert(tables.get("measurement", {}), PhiParameters)
    except msgspec.ValidationError:  # the check of the whole layout names the path
        return tables
    if taxels.positions is not None and "pitch_m" not in tables["taxels"]:
        with contextlib.suppress(LayoutError):  # the check of the whole layout names what is wrong
            tables["taxels"]["pitch_m"] = taxels.surface.pitch_m
    if parameters.matrix is not None:
        tables["measurement"].setdefault("sums", max([1, *map(len, parameters.matrix)]))
        tables.setdefault("bus", [])
        return tables
    return _with_choices(tables, parameters, blocks_of(taxels, parameters), is_whole=is_whole)


def _with_choices(tables: dict[str, Any], parameters: PhiParameters, blocks: int, *, is_whole: bool) -> dict[str, Any]:
    """Fill in sums, buses, and the rate of samples."""
    sends = SENDINGS.get(str(tables.get("sending")), IN_CYCLES)
    of_block = max(1, parameters.block_size // sends.taxels_per_sum)
    least = blocks * of_block if parameters.rows is None else len(parameters.rows)
    measurement, has_buses = tables.setdefault("measurement", {}), "bus" in tables
    has_sums = "sums" in measurement or parameters.rows is not None
    measurement.setdefault("sums", least)
    if "taxels" not in tables and not has_buses:  # without taxels and buses the file is no layout
        return tables
    most = NODES_PER_BUS if sends.in_cycles else min(NODES_PER_BUS, BUS_SUMS // parameters.block_size)
    fewest = -(-blocks // most)
    tables.setdefault("bus", _even_buses(blocks, fewest))
    try:
        layout = msgspec.convert(tables, Layout)
    except msgspec.ValidationError:  # the check of the whole layout names the path
        return tables
    if not layout.sends.in_cycles or not layout.bus:
        return tables
    if not has_buses:
        counts = range(fewest, min(BUSES_MAX, blocks) + 1)
        spread = (changed(layout, bus=msgspec.convert(_even_buses(blocks, count), list[Bus])) for count in counts)
        layout = next((each for each in spread if carries_enough(each, has_sums=has_sums)), layout)
        tables["bus"] = _even_buses(blocks, len(layout.bus))
    if not has_sums:
        measurement["sums"] = carried_sums(layout)
    sampling = tables.setdefault("sampling", {})
    if sampling.get("rate_hz") == layout.sync.rate_hz:  # one sample a SYNC
        del sampling["rate_hz"]
    elif not is_whole and (averaged := averaged_hz(layout)):
        sampling.setdefault("rate_hz", averaged)
    return tables


def _even_buses(blocks: int, buses: int) -> list[dict[str, Any]]:
    return [{"name": f"bus{each}", "nodes": (blocks + each) // buses} for each in range(buses)]


def validated(layout: Layout) -> Layout:
    """Check a layout that a program has built, and return it with every value in the type of its key."""
    try:
        document = msgspec.to_builtins(layout)
        checked = msgspec.convert(document, Layout)
    except msgspec.ValidationError as error:
        raise LayoutError(in_words(str(error), document, Layout)) from error
    check(checked)
    return checked


def layout_text(layout: Layout) -> str:
    """Return the layout as TOML; `parse_layout` reads the same layout from it."""
    tables = msgspec.to_builtins(layout)
    # TOML has no null, so such keys are left out. tomli-w would write short tables in lists inline.
    buses = [_bus_text(_given(bus)) for bus in tables.pop("bus")]
    tables = {key: _given(value) if isinstance(value, dict) else value for key, value in _given(tables).items()}
    if layout.sends.in_cycles:
        del tables["steps"]
    if layout.samples_per_sync == 1 and averaged_hz(layout):  # a missing key would mean averages
        tables["sampling"] = {"rate_hz": layout.sync.rate_hz}
    if "region" in tables:
        tables["region"] = [_given(each) for each in tables["region"]]
    return "\n[[bus]]\n".join([tomli_w.dumps({key: each for key, each in tables.items() if each != {}}), *buses])


def _bus_text(bus: dict[str, Any]) -> str:
    foreign = bus.pop("foreign")
    return "\n[[bus.foreign]]\n".join(map(tomli_w.dumps, [bus, *map(_given, foreign)]))


def _given(table: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in table.items() if value is not None}
