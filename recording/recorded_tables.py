"""What a notebook wants of a recording: arrays of images, measurements, contacts and labels."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import msgspec
import numpy as np
import numpy.typing as npt

from canskin.errors import InputError, RunError
from canskin.messages import CONTACTS, IMAGE, LABEL, MARK, MEASUREMENT, TRUTH, Contact, Measurement
from classifier.touches import Touches, touches_of
from recording.mcap_file import Read, Warn, read_messages, recording_id
from skin.layout import Layout
from skin.wall_times import WallTimes, nearest, recorded_wall_times

Table = dict[str, npt.NDArray[Any]]

#: Fields of `canskin.messages.Contact` that are a column for each of their three numbers.
_POINTS: Final = {"position_m": ("x_m", "y_m", "z_m"), "normal": ("nx", "ny", "nz")}
#: Its other fields are one column each.
_CONTACT_FIELDS: Final = {
    each.name: np.float64 if each.type is float else np.int64
    for each in msgspec.structs.fields(Contact)
    if each.name not in _POINTS
}


@dataclass
class Tables:
    """Arrays by name; the rows of a table belong together.

    Attributes
    ----------
    images : dict
        ``pixels`` float32 (n, rows, columns) in newtons, ``valid`` bool (n, blocks), ``valid_sums``, ``cycle``,
        and times: ``time_ns`` of the sampling on the wall clock, ``sampled_mono_ns``, ``sampled_error_ns``.
    measurements : dict
        ``sums`` and ``offsets`` int32 (n, m) in ADC counts, ``usable`` bool (n, m), ``valid``,
        ``cycle`` and times.
    contacts : dict
        One row per contact and image: the fields of `canskin.messages.Contact`, its position as ``x_m``, ``y_m``,
        ``z_m`` and its normal as ``nx``, ``ny``, ``nz``, ``cycle`` and times.
    labels : dict
        ``label``, ``confidence``, ``cycle`` and times.
    taxels : dict
        Of each taxel, row-major: ``row``, ``column``, where it lies, ``x_m``, ``y_m``, ``z_m``, its normal, ``nx``,
        ``ny``, ``nz``, and ``block``, the place of its block in ``valid``. A skin that is no grid has one row.
    touches : dict
        One row per touch: the fields of `classifier.touches.Touch`, with the label of marks or of ``skin label``.
    truth : dict
        ``true`` and ``sensor`` float32 (n, rows, columns) in newtons, ``label``, ``time_ns`` and ``cycle``, -1 where
        there is no measurement; of simulated nodes.
    recording : str
        `recording.mcap_file.RECORDING`: a column of each table.
    """

    images: Table = field(default_factory=dict)
    measurements: Table = field(default_factory=dict)
    contacts: Table = field(default_factory=dict)
    labels: Table = field(default_factory=dict)
    touches: Table = field(default_factory=dict)
    truth: Table = field(default_factory=dict)
    taxels: Table = field(default_factory=dict)
    recording: str = ""

    def named(self) -> dict[str, Table]:
        """Return the tables that have rows, by name, each with the column ``recording``."""
        tables = {name: table for name, table in vars(self).items() if isinstance(table, dict) and table}
        rows = {name: len(next(iter(table.values()))) for name, table in tables.items()}
        return {
            name: table | {"recording": np.full(rows[name], self.recording)}
            for name, table in tables.items()
            if rows[name]
        }


def read_tables(path: Path, layout: Layout, warn: Warn) -> Tables:
    """Return the tables of a recording.

    Raises
    ------
    RunError
        If there is nothing to read.
    """
    topics = IMAGE, MEASUREMENT, CONTACTS, LABEL, TRUTH
    read: dict[str, list[Any]] = {topic.name: [] for topic in topics}
    told: list[Read] = []
    for each in read_messages(path, (*topics, MARK), warn):
        if each.topic is not MARK:
            read[each.topic.name].append(each.message)
        if each.topic in {CONTACTS, MARK}:
            told.append(each)
    if not any(read.values()):
        raise RunError(f"{path}: holds no messages of the services, frames at most: play it with 'skin replay --out'")
    shape = (layout.taxels.rows, layout.taxels.columns)
    wall = recorded_wall_times(path)
    try:
        return Tables(
            # The pixels first: programs that read one array of a file take the first.
            images={"pixels": stack([each.pixels for each in read["image"]], "<f4", shape)}
            | _times(read["image"], wall)
            | {
                "valid": stack([each.valid for each in read["image"]], np.bool_, (layout.blocks,)),
                "valid_sums": np.array([each.valid_sums for each in read["image"]], np.int64),
            },
            measurements=_measurements(read["measurement"], wall, layout),
            contacts=_contacts(read["contacts"], wall),
            labels=_times(read["label"], wall)
            | {
                "label": np.array([each.label for each in read["label"]], np.str_),
                "confidence": np.array([each.confidence for each in read["label"]], np.float64),
            },
            touches=_touches(touches_of(path, told, warn), wall),
            truth=_truth_times(read["truth"], read["measurement"], layout, wall)
            | {
                "true": stack([each.true for each in read["truth"]], "<f4", shape),
                "sensor": stack([each.sensor for each in read["truth"]], "<f4", shape),
                "label": np.array([each.label for each in read["truth"]], np.str_),
            },
            taxels=_taxels(layout),
            recording=recording_id(path),
        )
    except (ValueError, OverflowError) as error:
        raise InputError(f"{path}: its messages do not fit the layout '{layout.name}': {error}") from error


def _measurements(messages: list[Measurement], wall: WallTimes, layout: Layout) -> Table:
    """Return the table of measurements; `layout` is that of their state."""
    sums = layout.measurement.sums
    none, all_usable = bytes(4 * sums), b"\1" * sums
    return _times(messages, wall) | {
        "sums": stack([each.sums for each in messages], "<i4", (sums,)),
        "offsets": stack([each.offsets or none for each in messages], "<i4", (sums,)),
        "usable": stack([each.usable or all_usable for each in messages], np.bool_, (sums,)),
        "valid": stack([each.valid for each in messages], np.bool_, (layout.blocks,)),
    }


def _touches(found: Touches | None, wall: WallTimes) -> Table:
    """Return the table of touches; `cycle` and `time_ns` are of the first image of a touch."""
    fields = ("number", "begin_ns", "end_ns", "force_n", "taxels", "contacts", "label")
    if not found:
        return {}
    first = [each.cycles[0] for each in found.touches]
    return {name: np.array([getattr(each, name) for each in found.touches]) for name in fields} | {
        "cycle": np.array([each.cycle for each in first], np.int64),
        "last_cycle": np.array([each.cycles[-1].cycle for each in found.touches], np.int64),
        "time_ns": wall.times_ns(each.sampled_mono_ns for each in first),
    }


def _taxels(layout: Layout) -> Table:
    row, column = np.divmod(np.arange(layout.taxels.count), layout.taxels.columns)
    phi = layout.phi()
    surface = layout.taxels.surface
    return {
        "row": row,
        "column": column,
        **_columns("position_m", surface.positions_m),
        **_columns("normal", surface.normals),
        "block": np.where(phi.is_wired, phi.block_of_taxel, -1),
    }


def _columns(name: str, points: npt.NDArray[np.float64]) -> Table:
    """Return the three columns of points, shape (n, 3), that are called `name`."""
    return dict(zip(_POINTS[name], points.T, strict=True))


def _truth_times(messages: list[Any], measurements: list[Measurement], layout: Layout, wall: WallTimes) -> Table:
    """Return number and time of the measurement of each truth; -1 and the nodes' own time where there is none."""
    wanted_ns = np.array([each.sampled_mono_ns for each in messages], np.int64)
    cycle, time_ns = np.full(len(messages), -1, np.int64), wall.times_ns(wanted_ns.tolist())
    if layout.sends.in_cycles and measurements:
        made = sorted((each.sampled_mono_ns, each.cycle) for each in measurements)
        at_ns, number = np.array(made, np.int64).T
        place, is_near = nearest(at_ns, wanted_ns, 0.5e9 * layout.sync.period_s)
        time_ns = np.where(is_near, wall.times_ns(at_ns.tolist())[place], time_ns)
        cycle = np.where(is_near, number[place], -1)
    return {"cycle": cycle, "time_ns": time_ns}


def _times(messages: list[Any], wall: WallTimes) -> Table:
    """Return number, times and error in time of messages; of a contact those of its image."""
    sampled_ns = [each.sampled_mono_ns for each in messages]
    return {
        "cycle": np.array([each.cycle for each in messages], np.int64),
        "time_ns": wall.times_ns(sampled_ns),
        "sampled_mono_ns": np.array(sampled_ns, np.int64),
        "sampled_error_ns": np.array([each.sampled_error_ns for each in messages], np.int64),
    }


def _contacts(messages: list[Any], wall: WallTimes) -> Table:
    found = [(each, contact) for each in messages for contact in each.contacts]
    columns: Table = {
        name: np.array([getattr(contact, name) for _, contact in found], kind) for name, kind in _CONTACT_FIELDS.items()
    }
    for name in _POINTS:
        points = np.array([getattr(contact, name) for _, contact in found], np.float64)
        columns |= _columns(name, points.reshape(-1, 3))
    return _times([each for each, _ in found], wall) | columns


def stack(contents: list[bytes], dtype: npt.DTypeLike, shape: tuple[int, ...]) -> npt.NDArray[Any]:
    """Return the arrays of messages, each of a `shape`, as one array; bytes of 0 and 1 as booleans."""
    kind = np.dtype(dtype)
    joined = np.frombuffer(b"".join(contents), np.uint8 if kind == np.bool_ else kind)
    return joined.reshape(len(contents), *shape).astype(kind, copy=False)


def flat(tables: Tables) -> Mapping[str, npt.NDArray[Any]]:
    """Return all arrays with the name of their table before their own: ``images_pixels``."""
    return {f"{name}_{column}": values for name, table in tables.named().items() for column, values in table.items()}
