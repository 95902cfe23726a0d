"""Reading a recording's arrays from a file: ``.npz``, ``.npy`` or ``.mcap``, never a pickle."""

import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError
from canskin.messages import IMAGE, TRUTH
from recording import RECORDING_SUFFIX, file_of, is_recording
from shell.service import say
from skin.limits import check_unpacked

Counts = npt.NDArray[Any]

#: Arrays of a recording of ``skin record``: its images, and of simulated nodes the true forces and the sensor's.
IN_MCAP: Final = {"image": (IMAGE, "pixels"), "true": (TRUTH, "true"), "sensor": (TRUTH, "sensor")}
#: Suffixes of the files that are read.
_READ_SUFFIXES: Final = (".npz", ".npy", RECORDING_SUFFIX)
_CAN_LOGS: Final = (".log", ".asc", ".blf", ".trc", ".mf4")


def read_counts(path: Path, arrays: Sequence[str] | None) -> tuple[Counts, ...]:
    """Return the arrays of a recording, each checked, of shape (frames, rows, columns).

    Parameters
    ----------
    path : pathlib.Path
        ``.npz`` (named arrays) or ``.npy`` (one); ``.mcap`` of ``skin record``: the arrays `IN_MCAP`, in newtons.
    arrays : sequence of str, optional
        Arrays of an ``.npz`` or ``.mcap``, in this order; default: the first array in the file of three axes.
    """
    if not file_of(path).is_file():
        raise InputError(f"no recording at '{path}': expected a .npz, .npy or .mcap file")
    suffix = file_of(path).suffix.lower()
    if suffix in _CAN_LOGS:
        raise InputError(
            f"'{path}' is a log of frames: make its images with 'skin replay {path} --out images.npz', and play those"
        )
    if suffix not in _READ_SUFFIXES:
        raise InputError(f"'{path}' is no recording: expected a .npz, .npy or .mcap file, got '{suffix}'")
    if arrays is not None and suffix not in {".npz", RECORDING_SUFFIX}:
        raise InputError(f"'{path}' has no named arrays: name arrays only of a .npz or .mcap file")
    if suffix == RECORDING_SUFFIX:
        return tuple(_read_mcap(path, name) for name in (arrays or array_names(path)[:1] or ("image",)))
    try:
        named = _read_numpy(path, arrays)
    except InputError:
        raise
    except Exception as error:  # NumPy and its libraries raise many kinds of errors for damaged files
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"'{path}' cannot be read as {suffix}: {reason}") from error
    for name, counts in named.items():
        _check(f"'{path}'" + f" array '{name}'" * bool(name), counts)
    return tuple(named.values()) if arrays is None else tuple(named[name] for name in arrays)


def array_names(path: Path) -> tuple[str, ...]:
    """Return the names of the arrays of three axes in an ``.npz`` or ``.mcap``, in file order; of other files none."""
    if is_recording(path):
        from recording.mcap_file import read_topics

        topics = read_topics(path)
        return tuple(name for name, (topic, _) in IN_MCAP.items() if topic.name in topics)
    if path.suffix.lower() != ".npz":
        return ()
    try:
        with path.open("rb") as file:
            check_unpacked(file, f"'{path}'")
            return tuple(name for name, shape in _shapes(file).items() if len(shape) == 3)
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
        wanted = list(arrays or ())
        if arrays is None:
            shapes = _shapes(file)
            wanted = [name for name, shape in shapes.items() if len(shape) == 3][:1]
            if not wanted:
                got = ", ".join(f"'{name}' of shape {shape}" for name, shape in shapes.items())
                raise InputError(f"'{path}' holds {got}: expected (time, rows, columns) of an array")
        if not wanted:
            raise InputError(f"no array named: '{path}' holds {', '.join(found)}")
        for name in wanted:
            if name not in found:
                raise InputError(f"'{path}' has no array '{name}': expected one of {', '.join(found)}")
        return {name: np.asarray(loaded[name]) for name in wanted}


def _shapes(file: BinaryIO) -> dict[str, tuple[int, ...]]:
    """Return the shape of each array of an ``.npz`` without reading its values; of a table with names none."""
    headers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
    found: dict[str, tuple[int, ...]] = {}
    with zipfile.ZipFile(file) as archive:
        for name in archive.namelist():
            with archive.open(name) as member:
                header = headers.get(np.lib.format.read_magic(member)) if name.endswith(".npy") else None
                found[name.removesuffix(".npy")] = header(member)[0] if header else ()
    return found


def _check(what: str, counts: Counts) -> None:
    if counts.dtype.kind not in "uif":
        raise InputError(f"{what} holds {counts.dtype}: expected integers or real numbers")
    if counts.ndim != 3 or not counts.size:
        raise InputError(f"{what} has shape {counts.shape}: expected (time, rows, columns), none of them 0")
    if not np.isfinite(counts).all():
        raise InputError(f"{what} holds NaN or infinity: expected finite forces of 0 or more")
    if counts.min() < 0:
        raise InputError(f"{what} holds {counts.min()}: expected forces of 0 or more")
