"""``skin export``: a recording as arrays, as a video, or for other programs."""

import csv
import io
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Final, Literal

import msgspec
import numpy as np

from canskin.errors import InputError, RunError, reasoned
from recording import is_recording
from recording.mcap_file import read_about
from shell.extras import not_installed
from shell.output import check_new_path, replacing
from shell.service import say
from skin.layout import layout_text, load_layout

if TYPE_CHECKING:
    from recording.tables import Table, Tables

Format = Literal["npz", "hdf5", "csv", "parquet", "video", "ros2", "rerun", "foxglove"]
_SUFFIXES: Final[Mapping[Format, str]] = {
    "npz": ".npz",
    "hdf5": ".h5",
    "csv": ".csv",
    "parquet": ".parquet",
    "video": ".mp4",
    "ros2": "",
    "rerun": ".rrd",
    "foxglove": "-foxglove.mcap",
}
#: Formats that are written message by message.
_VIEWS: Final = ("ros2", "rerun", "foxglove")
#: Arrays of images, which a .csv has in files of their own.
_GRIDS: Final = ("pixels", "true", "sensor")


def export(recording: Path, *, to: Format = "npz", out: Path | None = None) -> None:
    """Write a recording as arrays, as a video or as a bag of ROS 2.

    Arrays are read into memory as a whole: 100 MB for a minute of images of the default skin.

    Parameters
    ----------
    recording
        A recording (.mcap).
    to
        ``npz``: arrays ``images_pixels``, ``images_time_ns`` and so on. ``hdf5``: a group per table, gzip;
        needs the extra canskin[hdf5]. ``csv``: a file per table, and of images one line each. ``parquet``: a file per
        table, images as lists; needs the extra canskin[parquet]. ``video``: the images as
        H.264 in .mp4, in real time, with colours and marks of the page. ``ros2``: a bag of ROS 2, a folder with MCAP
        and CDR. ``rerun``, ``foxglove``: a file for their viewers. These four need the extra of their name.
    out
        New file; of a csv the names of the tables are added; default: the name of the recording.

    Examples
    --------
    skin export run.mcap --to hdf5 --out touches.h5
    skin export run.mcap --to video
    skin export run.mcap --to ros2 --out run-bag
    """
    if not is_recording(recording) or not recording.is_file():
        raise InputError(f"{recording}: expected a recording of 'skin record' (.mcap)")
    path = out or recording.with_name(recording.stem + _SUFFIXES[to])
    of_others = {suffix for other, suffix in _SUFFIXES.items() if suffix and other != to}
    if path.suffix.lower() in of_others:
        raise InputError(f"{path}: --to {to} writes no '{path.suffix}': expected another --to, or another suffix")
    if to == "video":
        _export_video(recording, path)
        return
    if to in _VIEWS:
        _save_view(recording, path, to)
        return
    from recording.tables import read_tables

    save = {"npz": _save_npz, "hdf5": _save_hdf5, "csv": _save_csv, "parquet": _save_parquet}[to]
    if to == "hdf5":
        _h5py()
    if to == "parquet":
        _pyarrow()
    check_new_path(path, "arrays")
    about = read_about(recording)
    layout = load_layout(recording)
    tables = read_tables(recording, layout, lambda line: say("export", line))
    metadata = {"format": "canskin arrays 1", "source": recording.name, **about.metadata, "layout": layout_text(layout)}
    with reasoned(RunError, f"{path}: the arrays cannot be written"):
        written = save(path, tables, metadata)
    counts = ", ".join(f"{len(next(iter(table.values())))} {name}" for name, table in tables.named().items())
    say("export", f"{counts} in {', '.join(map(str, written))}")


def _export_video(source: Path, path: Path) -> None:
    from recording.video import require_libraries, save_video

    require_libraries()
    check_new_path(path, "video", _SUFFIXES["video"])
    layout = load_layout(source)
    with reasoned(RunError, f"{path}: the video cannot be written"):
        made = save_video(path, source, layout, lambda line: say("export", line))
    say(
        "export",
        f"{made.images} images in {made.seconds:.2f} s of {path}, gaps: {made.gaps}, colours from 0 to"
        f" {1e3 * made.top_n:.0f} mN",
    )


def _save_view(source: Path, path: Path, to: Format) -> None:
    """Write a recording for other programs: a bag of ROS 2, or a file for Rerun or Foxglove."""
    check_new_path(path, "file" if path.suffix else "bag")
    layout = load_layout(source)

    def warn(line: str) -> None:
        say("export", line)

    with reasoned(RunError, f"{path}: cannot be written"):
        if to == "ros2":
            from views.ros2.bag import write_bag

            made = ", ".join(f"{count} {topic}" for topic, count in write_bag(source, path, layout, warn).items())
        else:
            from views.show.recording import write_view

            made = f"{write_view(source, path, layout, to == 'rerun', warn)} images"
    say("export", f"{made} in {path}")


def _save_npz(path: Path, tables: "Tables", metadata: Mapping[str, str]) -> list[Path]:
    from recording.tables import flat

    arrays: dict[str, Any] = {**flat(tables), "metadata": np.array(msgspec.json.encode(metadata).decode())}
    with replacing(path) as file:
        np.savez_compressed(file, **arrays)
    return [path]


def _save_hdf5(path: Path, tables: "Tables", metadata: Mapping[str, str]) -> list[Path]:
    h5py = _h5py()
    with replacing(path) as file, h5py.File(file.name, "w") as made:
        made.attrs.update(metadata)
        for name, table in tables.named().items():
            group = made.create_group(name)
            for column, values in table.items():
                if values.dtype.kind == "U":
                    group.create_dataset(column, data=values.astype(object), dtype=h5py.string_dtype())
                else:
                    group.create_dataset(column, data=values, compression="gzip", compression_opts=1)
    return [path]


def _save_csv(path: Path, tables: "Tables", _metadata: Mapping[str, str]) -> list[Path]:
    parts = {}
    for name, table in tables.named().items():
        grids = [column for column in table if column in _GRIDS]
        for column in grids or [""]:
            part = column if column in {"true", "sensor"} else name
            parts[part] = partial(_write_csv, table, column)
    return _save_parts(path, parts)


def _write_csv(table: "Table", column: str, file: BinaryIO) -> None:
    """Write a table, or its column of images."""
    text = io.TextIOWrapper(file, "utf-8", newline="")
    if column:
        text.writelines(_grid_lines(table, column))
    else:
        _write_rows(text, table)
    text.flush()
    text.detach()


def _save_parts(path: Path, parts: Mapping[str, Callable[[BinaryIO], None]]) -> list[Path]:
    """Write a file for each part, unless any of them is there already."""
    targets = {path.with_name(f"{path.stem}-{name}{path.suffix}"): write for name, write in parts.items()}
    for target in targets:
        check_new_path(target, "table")
    for target, write in targets.items():
        with replacing(target) as file:
            write(file)
    return [*targets]


def _grid_lines(table: "Table", column: str) -> Iterator[str]:
    """Yield the lines of images with their key, which ``--input`` of ``skin demo`` and ``skin rebuild`` read."""
    _, rows, columns = table[column].shape
    yield f"# shape: {rows} {columns}\n# recording: {table['recording'][0]}\n"
    yield ",".join(["time_ns", "cycle", *(f"r{row}c{place}" for row in range(rows) for place in range(columns))]) + "\n"
    for time_ns, cycle, image in zip(table["time_ns"], table["cycle"], table[column], strict=True):
        yield ",".join([str(time_ns), str(cycle), *(f"{value:.7g}" for value in image.ravel().tolist())]) + "\n"


def _write_rows(text: io.TextIOWrapper, table: "Table") -> None:
    """Write a table; an array of two dimensions has a column per place."""
    columns: dict[str, list[Any]] = {}
    for name, values in table.items():
        plain = values.astype(np.int64) if values.dtype == np.bool_ else values
        if plain.ndim == 1:
            columns[name] = plain.tolist()
        else:
            columns |= {f"{name}{place}": plain[:, place].tolist() for place in range(plain.shape[1])}
    rows = csv.writer(text)
    rows.writerow(columns)
    rows.writerows(zip(*columns.values(), strict=True))


def _save_parquet(path: Path, tables: "Tables", metadata: Mapping[str, str]) -> list[Path]:
    from pyarrow import parquet

    arrow = _pyarrow()

    def write(table: "Table", file: BinaryIO) -> None:
        rows = {
            column: arrow.array(values)
            if values.ndim == 1
            else arrow.FixedSizeListArray.from_arrays(arrow.array(values.ravel()), int(np.prod(values.shape[1:])))
            for column, values in table.items()
        }
        parquet.write_table(arrow.table(rows).replace_schema_metadata(metadata), file)

    return _save_parts(path, {name: partial(write, table) for name, table in tables.named().items()})


def _pyarrow() -> Any:
    """Return the library."""
    try:
        import pyarrow as pa
    except ImportError as error:
        raise not_installed("--to parquet needs pyarrow", "parquet") from error
    return pa


def _h5py() -> Any:
    """Return the library."""
    try:
        import h5py
    except ImportError as error:
        raise not_installed("--to hdf5 needs h5py", "hdf5") from error
    return h5py
