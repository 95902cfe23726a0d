"""Taxels from a few words or from the files of others: CSV, iCub position files, URDF with tactile sensors."""

import contextlib
import re
import xml.etree.ElementTree as ET
from collections import Counter
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
from skin.limits import TEXT_BYTES_MAX, read_file, read_text
from skin.surface import LINK_RATIO, Floats, surface_of_positions

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
    if modules is not None and path.suffix.lower() != ".txt":
        raise LayoutError(f"{text}: an .ini of modules is of an iCub's position file (.txt): leave out --ini")
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
    lines = read_text(path, LayoutError, "it", TEXT_BYTES_MAX).splitlines()
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
    told: list[str] = []
    try:
        links = _Links(robot)
        _check(robot)
        of_sensors = [
            (name := sensor.get("name", ""), _taxels(sensor, links.pose(_named(sensor, "parent", "link")), name, told))
            for sensor in robot.iter("sensor")
            if sensor.find("tactile") is not None
        ]
    except ValueError as error:
        raise LayoutError(f"{path}: not a description with tactile sensors: {error}") from error
    sensors = [(name, len(places)) for name, places in of_sensors if len(places)]
    if not sensors:
        raise LayoutError(f"{path}: expected a <sensor> with <tactile>, found none; expand xacro files first")
    return Imported(np.concatenate([places for _, places in of_sensors]).tolist(), None, told, sensors)


def _check(robot: ET.Element) -> None:
    """Check the number of taxels before any of them is made."""
    sizes = [(int(_attribute(each, "rows")), int(_attribute(each, "cols"))) for each in robot.iter("array")]
    if any(min(size) < 1 for size in sizes):
        raise ValueError(f"expected 1 row and column of an <array> or more, got {min(sizes, key=min)}")
    taxels = sum(rows * columns for rows, columns in sizes)
    if taxels > PLACES_MAX:
        raise ValueError(f"expected at most {PLACES_MAX} taxels, got {taxels}")


def _taxels(sensor: ET.Element, of_parent: RigidTransform, name: str, told: list[str]) -> Floats:
    """Return place and normal of each taxel of a sensor, shape (taxels, 6), in the order of its data."""
    frame = of_parent * RigidTransform.from_matrix(_steps([sensor])[0])
    found = [np.zeros((0, 6))]
    for tactile in sensor.iter("tactile"):
        array, taxels = tactile.find("array"), tactile.findall("taxel")
        if array is not None:
            found.append(_of_array(array, frame))
        numbers = [int(_attribute(each, "idx")) for each in taxels]
        if array is not None and taxels:
            raise ValueError(f"sensor '{name}' has both <array> and <taxel>: expected one of them")
        if wrong := [each for each, times in Counter(numbers).items() if each < 0 or times > 1]:
            raise ValueError(f"sensor '{name}': expected each idx once, from 0 on, got {wrong[0]} as idx of <taxel>")
        if numbers and len(numbers) <= max(numbers):
            told.append(f"sensor '{name}' has {len(numbers)} taxels of idx up to {max(numbers)}: gaps close up")
        if taxels:
            poses = frame * _poses([taxels[place] for place in np.argsort(numbers)])
            found.append(np.hstack([poses.translation, poses.rotation.as_matrix()[:, :, 2]]))
    return np.concatenate(found)


def _of_array(array: ET.Element, frame: RigidTransform) -> Floats:
    """Return place and normal of each taxel of an ``<array>``, shape (taxels, 6)."""
    rows, columns = int(_attribute(array, "rows")), int(_attribute(array, "cols"))
    along_x, along_y = _numbers(array.get("spacing") or _attribute(array, "size"), 2)
    start_x, start_y = _numbers(array.get("offset", "0 0"), 2)
    order = array.get("order", "row-major")
    if order not in {"row-major", "column-major"}:
        raise ValueError(f"expected row-major or column-major as order of an <array>, got {order}")
    row, column = np.divmod(np.arange(rows * columns), columns if order == "row-major" else rows)
    if order == "column-major":
        row, column = column, row
    places = frame.apply(np.stack([row * along_x - start_x, column * along_y - start_y, 0.0 * row], axis=1))
    return np.hstack([places, np.broadcast_to(frame.rotation.as_matrix()[:, 2], places.shape)])


class _Links:
    """The links of a robot in the frame of its root link, joints at zero."""

    def __init__(self, robot: ET.Element) -> None:
        joints = [each for each in robot.iter("joint") if each.find("child") is not None]
        self._joints = {_named(joint, "child", "link"): joint for joint in joints}
        if len(self._joints) < len(joints):
            twice = Counter(_named(joint, "child", "link") for joint in joints).most_common(1)[0][0]
            raise ValueError(f"link '{twice}' is the child of two joints: expected one")
        links = {_attribute(link, "name") for link in robot.iter("link")}
        named = {_named(each, "parent", "link") for each in (*joints, *robot.iter("sensor"))}
        if missing := (named | self._joints.keys()) - links:
            raise ValueError(f"no link '{min(missing)}'")
        self._poses: dict[str, Floats] = {}

    def pose(self, link: str) -> RigidTransform:
        """Return the pose of a link."""
        way: list[tuple[str, ET.Element]] = []
        while link not in self._poses and link in self._joints:
            way.append((link, self._joints[link]))
            link = _named(self._joints[link], "parent", "link")
            if len(way) > len(self._joints):
                raise ValueError(f"the joints of link '{link}' are a loop: expected a tree")
        pose = self._poses.get(link, np.eye(4))
        for (link, _), step in zip(way[::-1], _steps([joint for _, joint in way])[::-1], strict=True):
            pose = self._poses[link] = pose @ step
        return RigidTransform.from_matrix(pose)


def _steps(placed: Sequence[ET.Element]) -> Floats:
    """Return the transforms from joints or sensors to their parents, shape (placed, 4, 4)."""
    origins = [next(iter(each.findall("origin")), ET.Element("origin")) for each in placed]
    return _poses(origins).as_matrix() if origins else np.empty((0, 4, 4))


def _poses(origins: Sequence[ET.Element]) -> RigidTransform:
    turns, places = ([_numbers(each.get(key, "0 0 0"), 3) for each in origins] for key in ("rpy", "xyz"))
    return RigidTransform.from_components(places, Rotation.from_euler("xyz", turns))


def _named(element: ET.Element, tag: str, attribute: str) -> str:
    found = element.find(tag)
    if found is None:
        raise ValueError(f"<{element.tag}> without <{tag}>")
    return _attribute(found, attribute)


def _attribute(element: ET.Element, name: str) -> str:
    if name not in element.attrib:
        raise ValueError(f"<{element.tag}> without '{name}'")
    return element.attrib[name]


def _numbers(text: str, count: int) -> list[float]:
    values = [float(word) for word in text.split()]
    if len(values) != count or not np.isfinite(values).all():
        raise ValueError(f"expected {count} numbers, got '{text}'")
    return values
