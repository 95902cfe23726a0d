"""Files that programs write: paths are checked before the work, files are written in one step, or kept in a cache."""

import contextlib
import fcntl
import io
import os
import secrets
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO, Final

from canskin.errors import InputError, reasoned

#: Of a folder that one run uses.
LOCK: Final = ".lock"
PICTURE_SUFFIXES: Final = (".png", ".svg", ".pdf")


def cache_folder(environment: Mapping[str, str] = os.environ) -> Path:
    """Return ``$SKIN_CACHE``, else ``$XDG_CACHE_HOME/canskin``, else ``~/.cache/canskin``."""
    if chosen := environment.get("SKIN_CACHE"):
        return Path(chosen)
    if shared := environment.get("XDG_CACHE_HOME"):
        return Path(shared) / "canskin"
    return Path.home() / ".cache" / "canskin"


def check_new_path(path: Path, what: str, *suffixes: str) -> None:
    """Check as `check_output_path` that a file can be written, and that none is there."""
    if path.exists():
        raise InputError(f"{path}: is there already; remove it, or choose another name")
    check_output_path(path, what, *suffixes)


def check_output_path(path: Path, what: str, *suffixes: str) -> None:
    """Check that a file can be written at `path`, which ends in one of `suffixes`, if there are any.

    `what` names the file in the error.
    """
    if path.suffix.lower() not in (suffixes or {path.suffix.lower()}):
        expected = f"a file for the {what} that ends in {', '.join(suffixes)}"
        raise InputError(f"{path}: expected {expected}, got '{path.suffix}'")
    if not path.resolve().parent.is_dir():
        raise InputError(f"{path}: the folder for the {what} does not exist: make the folder, or give another path")
    is_new = not path.exists()
    with reasoned(InputError, f"{path}: cannot write the {what} there"):
        path.open("ab").close()
        if is_new:
            path.unlink()


def save_figure(figure: Any, path: Path, **options: Any) -> None:
    """Write a Matplotlib figure in one step, as `write_file` does; the suffix of `path` gives the format.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    content = io.BytesIO()
    figure.savefig(content, format=path.suffix[1:].lower(), **options)
    write_file(path, content.getvalue())


def write_file(path: Path, content: bytes | str) -> None:
    """Write a file in one step: after any failure, a full disk included, the old file is complete.

    The content is written with `replacing`. ``/dev/stdout`` and pipes are written directly. Text is written as UTF-8.

    Raises
    ------
    OSError
        If the file cannot be written; no part of it stays.
    """
    data = content.encode() if isinstance(content, str) else content
    target = path.resolve()  # a symbolic link stays a link
    if target.exists() and not target.is_file():
        target.write_bytes(data)
        return
    with replacing(target) as file:
        file.write(data)


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """Give a file to write, which takes the place of the regular file `path` at the end of the ``with``.

    The file stands beside `path` and is then renamed. Nothing is left of it when the ``with`` ends with an error.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    target = path.resolve()  # a link stays a link
    draft = target.with_name(f".{target.name}.{secrets.token_hex(4)}.part")
    try:
        with draft.open("xb") as file:
            yield file
            if target.exists():
                os.fchmod(file.fileno(), target.stat().st_mode & 0o7777)
        draft.replace(target)
    except BaseException:
        with contextlib.suppress(OSError):
            draft.unlink()
        raise


@contextlib.contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Lock a folder, made if need be, against other runs; raise InputError if another run uses it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        handle = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o644)
    except OSError as error:
        raise InputError(f"'{folder}' cannot be used as a folder: {error}; give another --out") from error
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(handle)
        raise InputError(f"another run uses '{folder}': wait for its end, or give another --out") from error
    try:
        for draft in folder.rglob(".*.part"):  # of a run that was killed
            draft.unlink(missing_ok=True)
        yield
    finally:
        os.close(handle)
