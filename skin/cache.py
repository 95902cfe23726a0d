"""The folder for what is made once and used again: models, compiled firmware."""

import os
from collections.abc import Mapping
from pathlib import Path


def cache_folder(environment: Mapping[str, str] = os.environ) -> Path:
    """Return ``$SKIN_CACHE``, else ``$XDG_CACHE_HOME/canskin``, else ``~/.cache/canskin``."""
    if chosen := environment.get("SKIN_CACHE"):
        return Path(chosen)
    if shared := environment.get("XDG_CACHE_HOME"):
        return Path(shared) / "canskin"
    return Path.home() / ".cache" / "canskin"
