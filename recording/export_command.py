"""``skin export``: a recording as arrays, as a video, or for other programs."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

import msgspec
import numpy as np

from canskin.errors import InputError, RunError, reasoned
from recording import beside, file_of, is_recording
from recording.mcap_file import part_of, read_about
from shell.extras import not_installed
from shell.output import check_new_path, replacing
from shell.service import say
from skin.layout import layout_text, load_layout

if TYPE_CHECKING:
    from recording.recorded_tables import Tables

Format = Literal["npz", "parquet", "video", "ros2", "rerun", "foxglove"]
_SUFFIXES: Final[Mapping[Format, str]] = {
    "npz": ".npz",
    "parquet": ".parquet",
    "video": ".mp4",
    "ros2": "",
    "rerun": ".rrd",
    "foxglove": "-foxglove.mcap",
}
#: Formats that are written message by message.
_VIEWS: Final = ("ros2", "rerun", "foxglove")


def export(recording: Path, *, to: Format = "npz", out: Path | None = None, skin: str | None = None) -> None:
    """Write a recording as arrays, as a video or as a bag of ROS 2.

    Arrays are read into memory as a whole: 100 MB for a minute of images of the default skin.

    Parameters
    ----------
    recording
        A recording (.mcap).
    to
        ``npz``: arrays ``images_pixels``, ``images_time_ns`` and so on. ``parquet``: a file per table, images as
        lists; pandas makes CSV and other formats of these. ``video``: the images as H.264 in .mp4, in real time, with
        colours and marks of the page. ``ros2``: a bag of ROS 2, a folder with MCAP and CDR. ``rerun``, ``foxglove``: a
        file for their viewers. All but ``npz`` need the extra of their name, for example canskin[parquet].
    out
        New file; without a suffix it gets that of its kind; of ``parquet`` the names of the tables are added. Default:
        the name of the recording.
    skin
        Name of the skin, where the recording has several.

    Examples
    --------
    skin export run.mcap
    skin export run.mcap --to parquet --out touches.parquet
    skin export run.mcap --to video
    skin export run.mcap --to ros2 --out run-bag
    """
    if not is_recording(recording) or not file_of(recording).is_file():
        raise InputError(f"{recording}: expected a recording of 'skin record' (.mcap)")
    recording = part_of(recording, skin)
    path = out or beside(recording, _SUFFIXES[to])
    suffix, got = Path(f"run{_SUFFIXES[to]}").suffix, path.suffix.lower()
    if got not in {"", suffix} and (suffix or got in {Path(f"run{each}").suffix for each in _SUFFIXES.values()}):
        raise InputError(f"{path}: --to {to} writes no '{path.suffix}': expected another --to, or another suffix")
    if not got:
        path = path.with_name(path.name + _SUFFIXES[to])
    if to == "video":
        _export_video(recording, path)
        return
    if to in _VIEWS:
        _save_view(recording, path, to)
        return
    from recording.recorded_tables import read_tables

    save = _save_npz if to == "npz" else _save_parquet
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
    from recording.recorded_tables import flat

    arrays: dict[str, Any] = {**flat(tables), "metadata": np.array(msgspec.json.encode(metadata).decode())}
    with replacing(path) as file:
        np.savez_compressed(file, **arrays)
    return [path]


def _save_parquet(path: Path, tables: "Tables", metadata: Mapping[str, str]) -> list[Path]:
    """Write a file for each table, unless any of them is there already."""
    from pyarrow import parquet

    arrow = _pyarrow()
    targets = {path.with_name(f"{path.stem}-{name}{path.suffix}"): table for name, table in tables.named().items()}
    for target in targets:
        check_new_path(target, "table")
    for target, table in targets.items():
        rows = {
            column: arrow.array(values)
            if values.ndim == 1
            else arrow.FixedSizeListArray.from_arrays(arrow.array(values.ravel()), int(np.prod(values.shape[1:])))
            for column, values in table.items()
        }
        with replacing(target) as file:
            parquet.write_table(arrow.table(rows).replace_schema_metadata(metadata), file)
    return [*targets]


def _pyarrow() -> Any:
    """Return the library."""
    try:
        import pyarrow as pa
    except ImportError as error:
        raise not_installed("--to parquet needs pyarrow", "parquet") from error
    return pa
