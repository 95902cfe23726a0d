"""The file of images: an ``.npz`` that NumPy reads without pickle."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt

from canskin.errors import InputError, RunError
from recording.cycles import Cycles
from shell.output import check_new_path, replacing


def check_out(path: Path) -> None:
    """Check that a new ``.npz`` can be written at `path`, before the work."""
    if path.suffix.lower() != ".npz":
        raise InputError(f"{path}: expected a file that ends in .npz for the images")
    check_new_path(path, "images")


def save_images(path: Path, images: npt.NDArray[np.float32], cycles: Cycles, metadata: Mapping[str, Any]) -> None:
    """Write images and metadata; the file appears only when it is complete.

    Arrays: ``images`` float32 (cycles, rows, columns) in newtons, ``valid`` bool (cycles, blocks), ``time_ns`` int64
    (cycles,), ``metadata`` a string of JSON.

    Raises
    ------
    RunError
        If the file cannot be written.
    """
    try:
        with replacing(path) as file:
            np.savez(
                file,
                images=images,
                valid=cycles.valid,
                time_ns=cycles.time_ns,
                metadata=np.array(msgspec.json.encode(metadata).decode()),
            )
    except OSError as error:
        raise RunError(f"{path}: the images cannot be written: {error.strerror or error}") from error
