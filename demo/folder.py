"""The folder of a run's logs and sockets, and what runs that were killed have left."""

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
#: A younger folder may be one whose run has not claimed it yet.
GRACE_S: Final = 60.0


@contextlib.contextmanager
def run_folder() -> Iterator[Path]:
    """Make a folder that lasts as long as the block; remove those of runs that died without removing theirs.

    A run holds a lock on its folder, which the kernel lets go when the run dies, however it dies.
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
    """Remove the folders of this user that nobody claims."""
    for folder in Path(tempfile.gettempdir()).glob(f"{PREFIX}*"):
        with contextlib.suppress(OSError):  # another user's, or gone meanwhile
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
