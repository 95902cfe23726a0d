"""The folder of a run's logs and sockets, and removal of the folders of killed runs."""

import contextlib
import fcntl
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final

PREFIX: Final = "skin-demo-"
#: Folders younger than this are kept: their run may not have locked them yet.
GRACE_S: Final = 60.0


@contextlib.contextmanager
def run_folder() -> Iterator[Path]:
    """Make a folder for the duration of the ``with``; remove the folders of killed runs.

    A run holds a lock on its folder; the kernel releases the lock when the run ends for any reason.
    """
    _sweep()
    with tempfile.TemporaryDirectory(prefix=PREFIX) as name:
        claim = os.open(name, os.O_RDONLY)
        try:
            fcntl.flock(claim, fcntl.LOCK_EX)
            yield Path(name)
        finally:
            os.close(claim)


def _sweep() -> None:
    """Remove this user's folders without a lock."""
    for folder in Path(tempfile.gettempdir()).glob(f"{PREFIX}*"):
        with contextlib.suppress(OSError):  # of another user, or removed meanwhile
            about = folder.lstat()
            if about.st_uid == os.getuid() and time.time() - about.st_ctime > GRACE_S:
                _remove_unclaimed(folder)


def _remove_unclaimed(folder: Path) -> None:
    claim = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        fcntl.flock(claim, fcntl.LOCK_EX | fcntl.LOCK_NB)
        shutil.rmtree(folder)
    finally:
        os.close(claim)
