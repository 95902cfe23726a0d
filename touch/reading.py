"""Reading a recording's arrays from a file: ``.npz``, ``.npy`` or ``.csv``, never a pickle."""

import re
import tokenize
import zipfile
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np
import numpy.typing as npt

from skin.errors import InputError

Counts = npt.NDArray[Any]

_SHAPE: Final = re.compile(r"#.*?\bshape\s*[:=]?\s*\(?\s*(\d{1,6})\s*[,xX ]\s*(\d{1,6})")
#: What damaged files of these formats raise in NumPy and in the libraries below it.
_UNREADABLE: Final = (
    OSError,
    EOFError,
    ValueError,
    KeyError,
    IndexError,
    OverflowError,
    MemoryError,
    SyntaxError,
    TypeError,
    RuntimeError,
    tokenize.TokenError,
    zipfile.BadZipFile,
    zlib.error,
)


def read_counts(
    path: Path, arrays: Sequence[str] | None, frame_shape: tuple[int, int] | None, skin_shape: tuple[int, int]
) -> tuple[Counts, ...]:
    """Return the arrays of a recording, each checked, of shape (frames, rows, columns).

    Parameters
    ----------
    path : pathlib.Path
        ``.npz`` (named arrays), ``.npy`` (one) or ``.csv`` (one frame per line).
    arrays : sequence of str, optional
        Which arrays of an ``.npz``, in this order; without it the first in file order.
    frame_shape : tuple of int, optional
        Rows and columns of a ``.csv``'s frames; without it the file's comment ``# shape: 64 32``, and
        without that `skin_shape`.
    skin_shape : tuple of int
        Rows and columns of the skin.

    Raises
    ------
    InputError
        If the file is missing or unreadable, or an array is not one of finite forces of 0 or more.
    """
    if not path.is_file():
        raise InputError(f"no recording at '{path}': expected a .npz, .npy or .csv file")
    suffix = path.suffix.lower()
    if suffix not in {".npz", ".npy", ".csv"}:
        raise InputError(f"'{path}' is no recording: expected a .npz, .npy or .csv file, got '{suffix}'")
    if arrays is not None and suffix != ".npz":
        raise InputError(f"'{path}' has no named arrays: name arrays only of a .npz file")
    try:
        named = _read_csv(path, frame_shape, skin_shape) if suffix == ".csv" else _read_numpy(path, arrays)
    except _UNREADABLE as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"'{path}' cannot be read as {suffix}: {reason}") from error
    for name, counts in named.items():
        _check(f"'{path}'" + f" array '{name}'" * bool(name), counts)
    return tuple(named.values()) if arrays is None else tuple(named[name] for name in arrays)


def array_names(path: Path) -> tuple[str, ...]:
    """Return the names of the arrays in an ``.npz``, in file order; of any other file none.

    Raises
    ------
    InputError
        If the file cannot be read.
    """
    if path.suffix.lower() != ".npz":
        return ()
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as loaded:
            return tuple(loaded.files)
    except _UNREADABLE as error:
        raise InputError(f"'{path}' cannot be read as .npz: {error}") from error


def _read_numpy(path: Path, arrays: Sequence[str] | None) -> dict[str, Counts]:
    with path.open("rb") as file:  # NumPy leaves a broken one open
        return _arrays_of(file, path, arrays)


def _arrays_of(file: BinaryIO, path: Path, arrays: Sequence[str] | None) -> dict[str, Counts]:
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


def _read_csv(path: Path, frame_shape: tuple[int, int] | None, skin_shape: tuple[int, int]) -> dict[str, Counts]:
    with path.open(encoding="utf-8") as file:
        lines = file.read().splitlines()
    written = next((found for line in lines if (found := _SHAPE.match(line.lstrip()))), None)
    if frame_shape is None and written:
        frame_shape = int(written[1]), int(written[2])
    rows, columns = frame_shape or skin_shape
    if not any(line.split("#")[0].strip() for line in lines):
        raise InputError(f"'{path}' holds no frame: expected one line per frame")
    values = np.loadtxt(lines, np.float64, comments="#", delimiter=",", ndmin=2)
    if values.shape[1] != rows * columns:
        raise InputError(
            f"'{path}' has {values.shape[1]} values per line: expected {rows} x {columns} = {rows * columns}; "
            f"give frame_shape, or the line '# shape: rows columns' in the file"
        )
    return {"": values.reshape(-1, rows, columns)}


def _check(what: str, counts: Counts) -> None:
    if counts.dtype.kind not in "uif":
        raise InputError(f"{what} holds {counts.dtype}: expected integers or real numbers")
    if counts.ndim != 3 or not counts.size:
        raise InputError(f"{what} has shape {counts.shape}: expected (time, rows, columns), none of them 0")
    if not np.isfinite(counts).all():
        raise InputError(f"{what} holds NaN or infinity: expected finite forces of 0 or more")
    if counts.min() < 0:
        raise InputError(f"{what} holds {counts.min()}: expected forces of 0 or more")
