"""Reading a recording's arrays from a file: ``.npz``, ``.npy``, ``.csv`` or ``.mcap``, never a pickle."""

import re
from collections.abc import Sequence
from io import BytesIO, TextIOWrapper
from itertools import islice, takewhile
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError
from canskin.messages import IMAGE, TRUTH
from recording import RECORDING_SUFFIX, is_recording
from shell.service import say
from skin.limits import check_unpacked, read_file

Counts = npt.NDArray[Any]

_SHAPE: Final = re.compile(r"#.*?\bshape\s*[:=]?\s*\(?\s*(\d{1,6})\s*[,xX ]\s*(\d{1,6})")
#: Possible delimiters, tried in this order.
_DELIMITERS: Final = (";", "\t", ",")
#: Names of the first columns of a .csv that hold no force.
_BESIDE: Final = re.compile(r"cycle|time.*|date.*|t|t_m?s|t\s*[\[(/].*", re.IGNORECASE)
#: Arrays of a recording of ``skin record``: its images, and of simulated nodes the true forces and the sensor's.
IN_MCAP: Final = {"image": (IMAGE, "pixels"), "true": (TRUTH, "true"), "sensor": (TRUTH, "sensor")}
#: Suffixes of the files that are read.
_READ_SUFFIXES: Final = (".npz", ".npy", ".csv", RECORDING_SUFFIX)
_CAN_LOGS: Final = (".log", ".asc", ".blf", ".trc", ".mf4")
#: Most bytes and lines of a .csv.
_CSV_BYTES_MAX: Final = 2**25
_CSV_LINES_MAX: Final = 2**19
#: Most characters of a wrong value in an error message.
_SHOWN: Final = 20


def read_counts(path: Path, arrays: Sequence[str] | None, skin_shape: tuple[int, int]) -> tuple[Counts, ...]:
    """Return the arrays of a recording, each checked, of shape (frames, rows, columns).

    Parameters
    ----------
    path : pathlib.Path
        ``.npz`` (named arrays), ``.npy`` (one) or ``.csv``: one frame per line, row by row, with ``,`` or ``;`` or a
        tab between the values. A header line is left out, and so is a time in the first column. ``.mcap`` of
        ``skin record``: the arrays `IN_MCAP`, in newtons.
    arrays : sequence of str, optional
        Arrays of an ``.npz`` or ``.mcap``, in this order; default: the first array in the file.
    skin_shape : tuple of int
        Rows and columns of the skin; also those of a ``.csv`` without the comment ``# shape: ROWS COLUMNS``.
    """
    if not path.is_file():
        raise InputError(f"no recording at '{path}': expected a .npz, .npy, .csv or .mcap file")
    suffix = path.suffix.lower()
    if suffix in _CAN_LOGS:
        raise InputError(
            f"'{path}' is a log of frames: make its images with 'skin replay {path} --out images.npz', and play those"
        )
    if suffix not in _READ_SUFFIXES:
        raise InputError(f"'{path}' is no recording: expected a .npz, .npy, .csv or .mcap file, got '{suffix}'")
    if arrays is not None and suffix not in {".npz", RECORDING_SUFFIX}:
        raise InputError(f"'{path}' has no named arrays: name arrays only of a .npz or .mcap file")
    if suffix == RECORDING_SUFFIX:
        return tuple(_read_mcap(path, name) for name in (arrays or array_names(path)[:1] or ("image",)))
    try:
        named = _read_csv(path, skin_shape) if suffix == ".csv" else _read_numpy(path, arrays)
    except InputError:
        raise
    except Exception as error:  # NumPy and its libraries raise many kinds of errors for damaged files
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"'{path}' cannot be read as {suffix}: {reason}") from error
    for name, counts in named.items():
        _check(f"'{path}'" + f" array '{name}'" * bool(name), counts)
    return tuple(named.values()) if arrays is None else tuple(named[name] for name in arrays)


def array_names(path: Path) -> tuple[str, ...]:
    """Return the names of the arrays in an ``.npz`` or ``.mcap``, in file order; for other files no names."""
    if is_recording(path):
        from recording.mcap_file import read_topics

        topics = read_topics(path)
        return tuple(name for name, (topic, _) in IN_MCAP.items() if topic.name in topics)
    if path.suffix.lower() != ".npz":
        return ()
    try:
        with path.open("rb") as file:
            check_unpacked(file, f"'{path}'")
            with np.load(file, allow_pickle=False) as loaded:
                return tuple(loaded.files)
    except InputError:
        raise
    except Exception as error:  # see `read_counts`
        raise InputError(f"'{path}' cannot be read as .npz: {error}") from error


def _read_mcap(path: Path, name: str) -> Counts:
    """Return the images, or the true or measured forces, of a run; frames alone have none."""
    from recording.mcap_file import read_messages
    from skin.layout import load_layout

    offered = array_names(path)
    if not offered:
        raise InputError(f"'{path}' holds no images: make them with 'skin replay {path} --out images.npz'")
    if name not in offered:
        raise InputError(f"'{path}' has no array '{name}': expected one of {', '.join(offered)}")
    topic, attribute = IN_MCAP[name]
    taxels = load_layout(path).taxels
    read = read_messages(path, [topic], lambda line: say("recording", line))
    try:
        content = b"".join(getattr(each.message, attribute) for each in read)
        return np.frombuffer(content, "<f4").reshape(-1, taxels.rows, taxels.columns)
    except ValueError as error:
        raise InputError(f"'{path}' array '{name}' cannot be read: {error}") from error


def _read_numpy(path: Path, arrays: Sequence[str] | None) -> dict[str, Counts]:
    with path.open("rb") as file:  # NumPy does not close a damaged file
        return _arrays_of(file, path, arrays)


def _arrays_of(file: BinaryIO, path: Path, arrays: Sequence[str] | None) -> dict[str, Counts]:
    check_unpacked(file, f"'{path}'")
    loaded = np.load(file, allow_pickle=False)
    if isinstance(loaded, np.ndarray):
        if arrays is not None:
            raise InputError(f"'{path}' holds one array without a name: leave the names out")
        return {"": loaded}
    with loaded:
        found = list(loaded.files)
        if not found:
            raise InputError(f"'{path}' holds no array: expected one of shape (time, rows, columns)")
        wanted = found[:1] if arrays is None else list(arrays)
        if not wanted:
            raise InputError(f"no array named: '{path}' holds {', '.join(found)}")
        for name in wanted:
            if name not in found:
                raise InputError(f"'{path}' has no array '{name}': expected one of {', '.join(found)}")
        return {name: np.asarray(loaded[name]) for name in wanted}


def _read_csv(path: Path, skin_shape: tuple[int, int]) -> dict[str, Counts]:
    content = BytesIO(read_file(path, InputError, "the recording", _CSV_BYTES_MAX))
    lines = list(islice(TextIOWrapper(content, "utf-8-sig"), _CSV_LINES_MAX + 1))
    if len(lines) > _CSV_LINES_MAX:
        raise InputError(f"'{path}': expected at most {_CSV_LINES_MAX} lines, got more: save longer recordings as .npy")
    written = next((found for line in lines if (found := _SHAPE.match(line.lstrip()))), None)
    rows, columns = (int(written[1]), int(written[2])) if written else skin_shape
    frames = {number: text for number, line in enumerate(lines, 1) if (text := line.partition("#")[0].strip())}
    last = next(reversed(frames.values()), "")
    delimiter = next((each for each in _DELIMITERS if each in last), ",")
    if delimiter != ",":  # a comma is then a decimal comma
        frames = {number: text.replace(",", ".") for number, text in frames.items()}
    names = _pop_header(frames, delimiter)
    if not frames:
        raise InputError(f"'{path}' holds no frame: expected one line per frame")
    values = _values(path, frames, delimiter)
    grows = bool((np.diff(values[:, 0]) >= 0).all())
    beside = sum(1 for _ in takewhile(_BESIDE.fullmatch, names))
    if beside == 0 and values.shape[1] == rows * columns + 1 and grows:
        beside = 1
    if beside:
        named = " and ".join(names[:beside]) or "the first column"
        say("recording", f"{path.name}: {named} left out, not taken for forces")
    values = values[:, beside:]
    if values.shape[1] != rows * columns:
        raise InputError(
            f"'{path}' has {values.shape[1]} values per line: expected {rows} x {columns} = {rows * columns}; "
            f"write the line '# shape: ROWS COLUMNS' at the top of the file"
        )
    return {"": values.reshape(-1, rows, columns)}


def _pop_header(frames: dict[int, str], delimiter: str) -> list[str]:
    """Remove the header line, if any, from `frames` (text by line number); return its names."""
    for number, text in frames.items():
        names = [each.strip().strip('"') for each in text.split(delimiter)]
        if _is_number(names[0]):
            return []
        del frames[number]
        return names
    return []


def _values(path: Path, frames: dict[int, str], delimiter: str) -> npt.NDArray[np.float64]:
    """Return the values of the frames, shape (lines, values of a line)."""
    width = next(iter(frames.values())).count(delimiter) + 1
    for number, text in frames.items():
        if text.count(delimiter) + 1 != width:
            found = text.count(delimiter) + 1
            raise InputError(f"'{path}' line {number} has {found} values: expected {width}, as in the lines before")
    try:
        return np.loadtxt(list(frames.values()), np.float64, comments=None, delimiter=delimiter, ndmin=2)
    except ValueError:
        for number, text in frames.items():
            for column, field in enumerate(text.split(delimiter), 1):
                if not _is_number(field):
                    place, shown = f"line {number}, value {column}", field.strip()[:_SHOWN]
                    raise InputError(f"'{path}' {place} is '{shown}': expected a number") from None
        raise


def _is_number(field: str) -> bool:
    try:
        float(field)
    except ValueError:
        return False
    return True


def _check(what: str, counts: Counts) -> None:
    if counts.dtype.kind not in "uif":
        raise InputError(f"{what} holds {counts.dtype}: expected integers or real numbers")
    if counts.ndim != 3 or not counts.size:
        raise InputError(f"{what} has shape {counts.shape}: expected (time, rows, columns), none of them 0")
    if not np.isfinite(counts).all():
        raise InputError(f"{what} holds NaN or infinity: expected finite forces of 0 or more")
    if counts.min() < 0:
        raise InputError(f"{what} holds {counts.min()}: expected forces of 0 or more")
