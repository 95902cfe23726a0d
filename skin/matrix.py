"""A Φ from a file: any matrix of 0 and ±1, one for all frames or one for each, for sums that other hardware makes.

Each sum is a block of its own: it comes, or is lost, alone. Where Φ changes from frame to frame, the matrices repeat
after the last: cycle c, from 1, has matrix (c - 1) mod frames.
"""

import hashlib
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError, LayoutError
from skin.limits import check_unpacked
from skin.operator import check_vectors
from skin.phi import Phi
from skin.text_tables import read_numbers

Entries = npt.NDArray[np.int8]

#: Most entries of all matrices: a layout with them as signs is below `skin.limits.FILE_BYTES_MAX`.
ENTRIES_MAX: Final = 2**23
#: The array of an .npz.
PHI: Final = "phi"
#: The entries -1, 0 and 1 as the signs of a layout.
_SIGNS: Final = np.frombuffer(b"-0+", np.uint8)
#: Where a layout has the matrix.
KEY: Final = "at `$.measurement.matrix`"
#: Part by which `MatrixPhi.norm_squared` is above the largest eigenvalue, for solvers in float32.
_MARGIN: Final = 1e-6


class MatrixPhi(Phi):
    """Φ as a dense matrix.

    Parameters
    ----------
    entries : array, shape (m, n) or (frames, m, n)
        0, 1 and -1, no row without an entry.
    is_wired : array of bool, shape (n,), optional
        Taxels that there are; default: all.

    Raises
    ------
    InputError
        If a shape or an entry does not fit.

    Attributes
    ----------
    entries : array of int8, shape (frames, m, n)
    """

    def __init__(self, entries: npt.NDArray[Any], is_wired: npt.NDArray[np.bool_] | None = None) -> None:
        self.entries = checked_entries(entries, "Φ")
        self._is_wired = np.ones(self.shape[1], np.bool_) if is_wired is None else is_wired
        if self._is_wired.shape != self.shape[1:]:
            raise InputError(f"Φ has {self.shape[1]} columns, expected {self._is_wired.size}, one for each taxel")
        if (felt := self.entries.any(axis=(0, 1)) & ~self._is_wired).any():
            raise InputError(f"taxel {int(np.argmax(felt))} is a gap, but a sum of Φ feels it: expected 0")

    @property
    def shape(self) -> tuple[int, int]:
        """(m, n): sums and taxels, gaps included."""
        _, sums, taxels = self.entries.shape
        return sums, taxels

    @property
    def frames(self) -> int:
        """Number of cycles after which Φ repeats."""
        return len(self.entries)

    @property
    def blocks(self) -> int:
        """Number of blocks: of sums."""
        return self.shape[0]

    @cached_property
    def block_of_sum(self) -> npt.NDArray[np.intp]:
        """Block of every sum, shape (m,): its number."""
        return np.arange(self.blocks)

    @property
    def is_wired(self) -> npt.NDArray[np.bool_]:
        """Which taxels there are, shape (n,); the others are gaps."""
        return self._is_wired

    def of_cycle(self, cycle: int) -> "MatrixPhi":
        """Return the Φ of a cycle; cycles are numbered from 1."""
        if self.frames == 1:
            return self
        frame = (cycle - 1) % self.frames
        if frame not in self._of_frames:
            self._of_frames[frame] = MatrixPhi(self.entries[frame], self._is_wired)
        return self._of_frames[frame]

    @cached_property
    def _of_frames(self) -> "dict[int, MatrixPhi]":
        return {}

    @cached_property
    def dense(self) -> npt.NDArray[np.float32]:
        """Φ as one array, shape (m, n); of a Φ that does not change."""
        return self._only.astype(np.float32)

    @cached_property
    def norm_squared(self) -> float:
        """Largest eigenvalue of ΦᵀΦ, from above; the largest of all frames."""
        largest = 0.0
        for frame in self.entries:
            thin = (frame if frame.shape[0] <= frame.shape[1] else frame.T).astype(np.float64)
            largest = max(largest, float(np.linalg.eigvalsh(thin @ thin.T)[-1]))
        return largest * (1 + _MARGIN)

    @cached_property
    def fingerprint(self) -> str:
        """16 hex digits that differ whenever any entry of any frame differs."""
        digest = hashlib.sha256(b"matrix")
        digest.update(np.asarray(self.entries.shape, "<u4").tobytes())
        digest.update(self.entries.tobytes())
        return digest.hexdigest()[:16]

    def forward(self, x: npt.NDArray[np.generic]) -> npt.NDArray[Any]:
        """Return y = Φ x, shape (..., m), of taxels (..., n); integers are summed exactly in int32."""
        check_vectors("taxels", x, self.shape[1])
        return _times(x, self._only.T)

    def adjoint(self, y: npt.NDArray[np.generic]) -> npt.NDArray[Any]:
        """Return Φᵀ y, shape (..., n), of sums (..., m)."""
        check_vectors("sums", y, self.shape[0])
        return _times(y, self._only)

    def valid_taxels(self, valid: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
        """Tell which taxels were measured, shape (n,): those that any valid sum feels."""
        return np.asarray(self._only[valid].any(axis=0), np.bool_)

    @property
    def _only(self) -> Entries:
        """The matrix of a Φ that does not change."""
        if self.frames > 1:
            raise InputError(f"Φ changes from frame to frame, {self.frames} of them: name one (`of_cycle`)")
        only: Entries = self.entries[0]
        return only


def _times(vectors: npt.NDArray[np.generic], matrix: Entries) -> npt.NDArray[Any]:
    kind = vectors.dtype if np.issubdtype(vectors.dtype, np.floating) else np.dtype(np.int32)
    product: npt.NDArray[Any] = vectors.astype(kind) @ matrix.astype(kind)
    return product


def read_matrix(path: Path) -> list[list[str]]:
    """Read a file of Φ, and return the rows of each matrix as signs, `+`, `-` and `0`.

    Parameters
    ----------
    path : pathlib.Path
        ``.csv``: a line for each sum, a value for each taxel; lines that begin with # are left out. ``.npz``: the array
        `PHI`, shape (m, n), or (frames, m, n) for a Φ that changes from frame to frame.

    Raises
    ------
    LayoutError
        If the file cannot be read, lacks the array, or holds other values.
    """
    try:
        is_packed = path.suffix.lower() == ".npz"
        entries = _read_npz(path) if is_packed else read_numbers(path, InputError, "the matrix")
        return signs_of(checked_entries(entries, path))
    except InputError as error:
        raise LayoutError(f"{error} - {KEY}") from error


def _read_npz(path: Path) -> npt.NDArray[Any]:
    try:
        with path.open("rb") as file:
            check_unpacked(file, path)
            with np.load(file, allow_pickle=False) as arrays:
                names = list(arrays.files)
                if PHI in names:
                    return np.asarray(arrays[PHI])
    except InputError:
        raise
    except Exception as error:  # the zip and npy decoders raise many kinds of errors
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: cannot read the matrix: expected an .npz of numbers: {reason}") from error
    raise InputError(f"{path}: expected the array '{PHI}', got {', '.join(names) or 'none'}")


def checked_entries(entries: Any, where: object) -> Entries:
    """Return the matrices of Φ, int8, shape (frames, m, n); raise InputError for another shape, value, or empty row."""
    if not isinstance(entries, np.ndarray) or entries.dtype.kind not in "biuf":
        seen = entries.dtype if isinstance(entries, np.ndarray) else type(entries).__name__
        raise InputError(f"{where}: expected an array of 0, 1 and -1, got {seen}")
    if entries.ndim not in {2, 3} or not entries.size:
        raise InputError(f"{where}: expected the shape (sums, taxels) or (frames, sums, taxels), got {entries.shape}")
    if entries.size > ENTRIES_MAX:
        raise InputError(f"{where}: expected at most {ENTRIES_MAX} entries, got {entries.size}")
    found = entries if entries.ndim == 3 else entries[None]
    wrong = (found != 0) & (found != 1) & (found != -1)
    if wrong.any():
        frame, row, column = (int(each[0]) for each in np.nonzero(wrong))
        what = f"{found[frame, row, column]} in row {row}, column {column}{f', frame {frame}' * (entries.ndim == 3)}"
        raise InputError(f"{where}: expected 0, 1 and -1, got {what}")
    empty = ~found.any(axis=2)
    if empty.any():
        frame, row = (int(each[0]) for each in np.nonzero(empty))
        which = f"row {row}{f' of frame {frame}' * (entries.ndim == 3)}"
        raise InputError(f"{where}: {which} has zeros alone: expected a sum of one taxel or more")
    return found.astype(np.int8, copy=False)


def signs_of(entries: Entries) -> list[list[str]]:
    """Return the rows of each matrix, shape (frames, m, n), as signs, `+`, `-` and `0`."""
    lines = _SIGNS[entries + 1]
    return [[row.tobytes().decode() for row in frame] for frame in lines]


def entries_of(signs: Sequence[Sequence[str]]) -> Entries:
    """Return the matrices of rows of signs, shape (frames, m, n).

    Raises
    ------
    LayoutError
        If rows or frames differ in length, or a row has zeros alone.
    """
    if not signs or not signs[0]:
        raise LayoutError(f"expected a row for each sum, got none - {KEY}")
    sums, taxels = len(signs[0]), len(signs[0][0])
    for frame, rows in enumerate(signs):
        if len(rows) != sums:
            raise LayoutError(f"expected {sums} rows, as in frame 0, got {len(rows)} in frame {frame} - {KEY}")
        for row, line in enumerate(rows):
            if len(line) != taxels:
                limit = f"expected {taxels} signs, as in row 0"
                raise LayoutError(f"{limit}, got {len(line)} in row {row} of frame {frame} - {KEY}")
    codes = np.frombuffer("".join(line for rows in signs for line in rows).encode(), np.uint8)
    entries = (codes == _SIGNS[2]).astype(np.int8) - (codes == _SIGNS[0]).astype(np.int8)
    try:
        return checked_entries(entries.reshape(len(signs), sums, taxels), "Φ")
    except InputError as error:
        raise LayoutError(f"{error} - {KEY}") from error
