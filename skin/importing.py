"""Taxels from a few words or from the files of others: CSV, iCub position files, URDF with tactile sensors."""

import contextlib
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from itertools import accumulate
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from canskin.errors import LayoutError
from skin.chains import chains_of, read_positions
from skin.layout import NAME_CHARACTERS, load_layout
from skin.layout_keys import PLACES_MAX
from skin.limits import TEXT_BYTES_MAX, read_file
from skin.surface import LINK_RATIO, surface_of_positions

#: Channels of a converter of the iCub's skin, and those of a triangle that measure temperature in place of touch.
ICUB_CHANNELS: Final = 12
TRIANGLE: Final = "triangle_10pad"
THERMAL_PADS: Final = (6, 10)
#: Multiples of the spacing that are tried.
LINK_RATIOS: Final = (LINK_RATIO, 1.8, 2.0, 2.5, 3.0)
#: Converters of each kind of module; other modules of an ``.ini`` are refused.
ICUB_MODULES: Final = {
    TRIANGLE: 1,
    "triangle": 1,
    **dict.fromkeys((f"fingertip{kind}" for kind in ("", "2L", "2R", "3L", "3R", "4L", "4R")), 1),
    "palmL": 4,
    "palmR": 4,
}


class Imported(NamedTuple):
    """Taxels in space.

    Attributes
    ----------
    places : list of list of float
        x, y, z in metres of each taxel, and its normal if all have one.
    boards : list of (int, int) or None
        Board of each taxel, and its place there; None where the file does not tell.
    told : list of str
        What the file has, and was left out.
    sensors : sequence of (str, int)
        Name of each sensor, and its number of taxels, in their order; empty where the file has no sensors.
    """

    places: list[list[float]]
    boards: list[tuple[int, int]] | None
    told: list[str]
    sensors: Sequence[tuple[str, int]] = ()


def tables_of(text: str, modules: Path | None = None) -> tuple[dict[str, Any], list[str]]:
    """Return the tables of a layout that have its taxels and, where they are known, its boards.

    Parameters
    ----------
    text : str
        Rows and columns, as ``24x32``; or a file: ``.csv`` of positions, ``.txt`` of an iCub's skin, ``.urdf``, or a
        layout.
    modules : pathlib.Path, optional
        For an iCub's skin, see `read_icub`.

    Returns
    -------
    tables : dict
        ``taxels``, ``measurement`` if the boards are known, and ``region`` if there are several sensors.
    told : list of str
        What the file has, and was left out.
    """
    path = Path(text)
    if found := re.fullmatch(r"(\d+)[xX×*](\d+)", text):
        return {"taxels": dict(zip(("rows", "columns"), map(int, found.groups()), strict=True))}, []
    match path.suffix.lower():
        case ".csv":
            places, chains = read_positions(path)
            found_here = Imported(places, None, [])
        case ".txt":
            found_here = read_icub(path, modules)
            chains = chains_of(found_here.boards or [])
        case ".urdf":
            found_here, chains = read_urdf(path), None
        case _:
            layout = load_layout(path)
            given = {key: value for key, value in msgspec.to_builtins(layout.taxels).items() if value is not None}
            return {"taxels": given}, []
    tables: dict[str, Any] = {"taxels": {"positions": found_here.places, **_linked(found_here.places)}}
    if chains is not None:
        tables["measurement"] = {"wiring": "file", "chains": chains}
    names = {name_of(name, "sensor") for name, _ in found_here.sensors}
    if 1 < len(names) == len(found_here.sensors):
        ends = accumulate(count for _, count in found_here.sensors)
        tables["region"] = [
            {"name": name_of(name, "sensor"), "box": [0, end - count, 0, end - 1]}
            for (name, count), end in zip(found_here.sensors, ends, strict=True)
        ]
    return tables, found_here.told


def new_name(taxels: str, out: Path | None) -> str:
    """Return the name of a new skin: of the file that is written, else of its taxels."""
    return name_of((Path(taxels) if out is None else out).stem, "skin")


def name_of(text: str, kind: str) -> str:
    """Return a name that layouts take for one of others; `kind` comes before a name that begins with no letter."""
    name = re.sub(r"[^a-z0-9_]", "_", text.lower())
    return (name if name[:1].isalpha() else f"{kind}_{name}")[:NAME_CHARACTERS]


def _linked(places: list[list[float]]) -> dict[str, float]:
    """Return the least of `LINK_RATIOS` that leaves no taxel alone, as a key of the layout; none for the first."""
    for ratio in LINK_RATIOS:
        with contextlib.suppress(LayoutError):  # the check of the layout names what is wrong
            surface_of_positions(places, ratio)
            return {} if ratio == LINK_RATIO else {"link_ratio": ratio}
    return {}


def read_icub(path: Path, modules: Path | None) -> Imported:
    """Read a position file of the iCub's skin; each converter is a board.

    Some files repeat the position of one channel for others whose position nobody has measured: these are left out.

    Parameters
    ----------
    path : pathlib.Path
        After the line ``[calibration]`` a line of six numbers for each channel: position in metres and normal, all 0
        where there is no taxel.
    modules : pathlib.Path
        The ``.ini`` of this part: after the line ``[SENSORS]`` a line for each module, its kind and its number.

    Raises
    ------
    LayoutError
        If a file is no such file, or names a module whose channels are not known here.
    """
    if modules is None:
        raise LayoutError(f"{path}: an iCub position file needs the .ini of its part, for its modules: --ini FILE")
    channels = [_six_numbers(path, number, words) for number, words in _lines_after(path, "[calibration]")]
    named = list(_modules(modules))
    found = {}
    for kind, module in named:
        for place, values in enumerate(channels[module * ICUB_CHANNELS :][: ICUB_MODULES[kind] * ICUB_CHANNELS]):
            if any(values) and not (kind == TRIANGLE and place in THERMAL_PADS):
                found[module, place] = values
    once = {tuple(values[:3]): key for key, values in reversed(found.items())}
    kept = {key: values for key, values in found.items() if once[tuple(values[:3])] == key}
    converters = sorted({module + place // ICUB_CHANNELS for module, place in kept})
    boards = [(converters.index(module + place // ICUB_CHANNELS), place % ICUB_CHANNELS) for module, place in kept]
    places, doubled = list(kept.values()), len(found) - len(kept)
    empty = [module for _, module in named if module not in {each for each, _ in found}]
    told = [f"module {module} of {modules.name} has no positions, and is left out" for module in empty]
    if not places:
        raise LayoutError(f"{path}: no channel of the modules in {modules.name} has a position")
    if doubled:
        told.append(f"{doubled} channels of {path.name} have the position of another, and are left out")
    if not all(any(values[3:]) for values in places):
        told.append(f"{path.name} has no normals of some channels: all are made from the taxels around")
        places = [values[:3] for values in places]
    return Imported(places, boards, told)


def _six_numbers(path: Path, number: int, words: list[str]) -> list[float]:
    try:
        values = [float(word) for word in words]
    except ValueError as error:
        raise LayoutError(f"{path}, line {number}: expected six numbers: {error}") from error
    if len(values) != 6:
        raise LayoutError(f"{path}, line {number}: expected six numbers, got {len(values)}")
    return values


def _modules(path: Path) -> Iterator[tuple[str, int]]:
    """Yield kind and number of the modules of an ``.ini``."""
    for number, words in _lines_after(path, "[SENSORS]"):
        if len(words) < 2 or words[0] not in ICUB_MODULES or not words[1].isdecimal():
            expected = f"expected one of {', '.join(ICUB_MODULES)} and its number"
            raise LayoutError(f"{path}, line {number}: {expected}, got {' '.join(words[:2])}")
        yield words[0], int(words[1])


def _lines_after(path: Path, heading: str) -> Iterator[tuple[int, list[str]]]:
    """Yield number and words of the lines after a heading, without comments and empty lines."""
    lines = read_file(path, LayoutError, "it", TEXT_BYTES_MAX).decode("utf-8", errors="replace").splitlines()
    first = next((number for number, line in enumerate(lines, 1) if line.strip() == heading), None)
    if first is None:
        raise LayoutError(f"{path}: expected a line {heading}, found none")
    for number, line in enumerate(lines[first:], first + 1):
        words = line.partition("#")[0].split()
        if words:
            yield number, words


def read_urdf(path: Path) -> Imported:
    """Read the taxels of a robot's description, in the frame of its root link, joints at zero.

    Each ``<sensor>`` with ``<tactile>`` has an ``<array>`` of rows along its x axis and columns along y, or one
    ``<taxel>`` for each taxel; z is the normal (the syntax of ``urdf_tactile``).

    Raises
    ------
    LayoutError
        If the file is no such description, or has no taxel.
    """
    content = read_file(path, LayoutError, "the URDF", TEXT_BYTES_MAX)
    try:
        robot = ET.fromstring(content)  # noqa: S314  expat bounds what its entities grow to
    except ET.ParseError as error:
        raise LayoutError(f"{path}: cannot read it as URDF: {error}") from error
    try:
        parents = {
            _named(joint, "child", "link"): joint for joint in robot.iter("joint") if joint.find("child") is not None
        }
        _check(robot)
        of_sensors = [
            (sensor.get("name", ""), [*_taxels(sensor, _of_link(_named(sensor, "parent", "link"), parents))])
            for sensor in robot.iter("sensor")
            if sensor.find("tactile") is not None
        ]
    except (KeyError, ValueError, RecursionError) as error:
        raise LayoutError(f"{path}: not a description with tactile sensors: {error!r}") from error
    sensors = [(name, len(poses)) for name, poses in of_sensors if poses]
    if not sensors:
        raise LayoutError(f"{path}: expected a <sensor> with <tactile>, found none; expand xacro files first")
    places = [[*pose.translation, *pose.rotation.as_matrix()[:, 2]] for _, poses in of_sensors for pose in poses]
    return Imported([[float(value) for value in place] for place in places], None, [], sensors)


def _check(robot: ET.Element) -> None:
    links = {link.attrib["name"] for link in robot.iter("link")}
    if missing := {_named(each, "parent", "link") for each in robot.iter("sensor")} - links:
        raise KeyError(f"no link {min(missing)}")
    taxels = sum(abs(int(each.get("rows", "0")) * int(each.get("cols", "0"))) for each in robot.iter("array"))
    if taxels > PLACES_MAX:
        raise ValueError(f"expected at most {PLACES_MAX} taxels, got {taxels}")


def _taxels(sensor: ET.Element, of_parent: RigidTransform) -> Iterator[RigidTransform]:
    """Yield the pose of each taxel of a sensor, in the order of its data."""
    frame = of_parent * _pose(sensor.find("origin"))
    for tactile in sensor.iter("tactile"):
        array = tactile.find("array")
        if array is not None:
            rows, columns = int(array.attrib["rows"]), int(array.attrib["cols"])
            along_x, along_y = _numbers(array.get("spacing") or array.attrib["size"], 2)
            start_x, start_y = _numbers(array.get("offset", "0 0"), 2)
            by_column = array.get("order", "row-major") == "column-major"
            for number in range(rows * columns):
                row, column = divmod(number, rows)[::-1] if by_column else divmod(number, columns)
                place_m = row * along_x - start_x, column * along_y - start_y, 0.0
                yield frame * RigidTransform.from_translation(place_m)
        for taxel in sorted(tactile.iter("taxel"), key=lambda each: int(each.attrib["idx"])):
            yield frame * _pose(taxel)


def _of_link(link: str, parents: dict[str, ET.Element]) -> RigidTransform:
    """Return the pose of a link in the frame of the root link."""
    joint = parents.get(link)
    if joint is None:
        return RigidTransform.identity()
    return _of_link(_named(joint, "parent", "link"), parents) * _pose(joint.find("origin"))


def _pose(origin: ET.Element | None) -> RigidTransform:
    given = {} if origin is None else origin.attrib
    turn = Rotation.from_euler("xyz", _numbers(given.get("rpy", "0 0 0"), 3))
    return RigidTransform.from_components(_numbers(given.get("xyz", "0 0 0"), 3), turn)


def _named(element: ET.Element, tag: str, attribute: str) -> str:
    found = element.find(tag)
    if found is None:
        raise KeyError(f"<{element.tag}> without <{tag}>")
    return found.attrib[attribute]


def _numbers(text: str, count: int) -> list[float]:
    values = [float(word) for word in text.split()]
    if len(values) != count or not np.isfinite(values).all():
        raise ValueError(f"expected {count} numbers, got '{text}'")
    return values
