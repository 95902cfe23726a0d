"""Recordings of a running skin: made, played again through the services, and turned into other files."""

from pathlib import Path
from typing import Final

#: Ends the name of a recording, which holds the layout of its skin.
RECORDING_SUFFIX: Final = ".mcap"


def is_recording(path: Path | None) -> bool:
    """Tell whether a path is a recording of ``skin record``, or a skin of such a file, by its name."""
    return path is not None and file_of(path).suffix.lower() == RECORDING_SUFFIX


def file_of(path: Path) -> Path:
    """Return the file of a recording: of one skin of many, ``run.mcap/palm``, that is ``run.mcap``."""
    is_part = not path.suffix and path.parent.suffix.lower() == RECORDING_SUFFIX
    return path.parent if is_part else path


def beside(path: Path, ending: str) -> Path:
    """Return the path of what belongs to a recording: ``run.npz``, of one skin of many ``run-palm.npz``."""
    file = file_of(path)
    return file.with_name(file.stem + (f"-{path.name}" if file != path else "") + ending)
