"""Recordings of a running skin: made, played again through the services, and turned into other files."""

from pathlib import Path
from typing import Final

#: Ends the name of a recording, which holds the layout of its skin.
RECORDING_SUFFIX: Final = ".mcap"


def is_recording(path: Path | None) -> bool:
    """Tell whether a file is a recording of ``skin record``, by its name."""
    return path is not None and path.suffix.lower() == RECORDING_SUFFIX
