"""The zero that outlives a run, in a file: ``skin gateway --keep-zero``."""

from collections.abc import Callable
from pathlib import Path
from typing import Final

import msgspec
import numpy as np

from calibration.windows import Floats
from canskin.errors import InputError
from shell.output import write_file
from shell.service import say
from skin.calibration_file import StoredCalibration, encoded, load_calibration, most_offset_n, new_calibration
from skin.layout import Layout

#: Time between two writes of the zero to its file.
KEEP_S: Final = 60.0


class KeptZero:
    """Writes the zero to its file, once a minute.

    Parameters
    ----------
    first_n : array, shape (m,), optional
        The offsets that the file has, newtons.
    submit : callable
        Calls what it is given, soon, in another thread.
    """

    def __init__(
        self, path: Path, layout: Layout, first_n: Floats | None, submit: Callable[[Callable[[], None]], object]
    ) -> None:
        self._path, self._layout, self._submit = path, layout, submit
        self._kept_n, self._due_s = first_n, float("-inf")
        self._has_failed = False

    def hasten(self) -> None:
        """Write at the next `tick`."""
        self._due_s = float("-inf")

    def tick(self, offsets_n: Floats | None, now_s: float) -> None:
        """Write the zero if it is time for that."""
        if offsets_n is not None and now_s >= self._due_s:
            self._due_s = now_s + KEEP_S
            self.keep(offsets_n)

    def keep(self, offsets_n: Floats | None) -> None:
        """Write the zero, shape (m,), newtons, if there is a new one; an error is said once."""
        if offsets_n is None:
            return
        usable_n = np.where(np.abs(offsets_n) <= most_offset_n(self._layout), offsets_n, np.nan)
        if self._kept_n is not None and np.array_equal(usable_n, self._kept_n, equal_nan=True):
            return
        self._kept_n = usable_n
        self._submit(lambda: self._write(usable_n))

    def _write(self, offsets_n: Floats) -> None:
        try:
            write_file(self._path, encoded(new_calibration(self._layout, offsets_n=offsets_n)))
            self._has_failed = False
        except OSError as error:
            if not self._has_failed:
                say("gateway", f"{self._path}: cannot keep the zero there: {error.strerror or error}")
            self._has_failed = True


def kept_zero(path: Path, layout: Layout, stored: StoredCalibration | None) -> StoredCalibration | None:
    """Return a calibration with the zero that an earlier run has kept: the first guess of this run.

    A file that is damaged, or of another layout, is said; the gateway starts without it.

    Parameters
    ----------
    stored : StoredCalibration or None
        What is used without a zero from before; its gains are used with one, too.
    """
    try:
        found = load_calibration(path, layout)
        found.required_offsets_n(str(path))
    except InputError as error:
        if not isinstance(error.__cause__, FileNotFoundError):  # as before the first run
            say("gateway", f"starts without the zero of an earlier run: {error}")
        return stored
    say("gateway", f"begins with the zero of {found.saved}, from {path}")
    return found if stored is None else msgspec.structs.replace(stored, offsets_n=found.offsets_n)
