"""Where a picture may be saved, found out before the work that it shows."""

from pathlib import Path
from typing import Final

from skin.errors import InputError

SUFFIXES: Final = (".png", ".svg", ".pdf")


def check_place(path: Path) -> None:
    """Check that a picture can be saved at `path`.

    Raises
    ------
    InputError
        If the folder does not exist, the name has none of `SUFFIXES`, or no file can be written there.
    """
    if not path.resolve().parent.is_dir():
        raise InputError(f"{path}: the folder for the picture does not exist")
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"{path}: expected a picture that ends in {', '.join(SUFFIXES)}, got '{path.suffix}'")
    is_new = not path.exists()
    try:
        path.open("ab").close()
        if is_new:
            path.unlink()
    except OSError as error:
        raise InputError(f"{path}: cannot write the picture there: {error.strerror or error}") from error
