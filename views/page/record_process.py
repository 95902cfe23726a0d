"""``skin record`` as a process of its own, which the page starts and stops."""

import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import IO, Final

from canskin.errors import RunError
from health.causes import Cause
from health.snapshot import Notice, RecorderState
from recording import RECORDING_SUFFIX
from shell.service import given_priority, say

#: Longest wait for a recorder that starts, and that ends.
PATIENCE_S: Final = 30.0
_LOOK_S: Final = 0.05


class RecorderProcess:
    """Records the messages of a skin; frames of buses are those of ``skin record``, which knows the interfaces.

    Parameters
    ----------
    folder : pathlib.Path
        Of the recordings, which are named by skin and time. None is written over.
    endpoint, skin : str
        Of the hub, and name of the skin there.
    """

    def __init__(self, folder: Path, endpoint: str, skin: str) -> None:
        self._folder, self._endpoint, self._skin = folder.resolve(), endpoint, skin
        self._lock = threading.Lock()
        # A recorder ends with the thread that started it (PR_SET_PDEATHSIG): threads of requests do not last.
        self._parent = ThreadPoolExecutor(1, "recorder")
        self._process: subprocess.Popen[bytes] | None = None
        self._log: IO[bytes] | None = None
        self._state: RecorderState | None = None
        self.notices: list[Notice] = []

    @property
    def state(self) -> RecorderState | None:
        """The recording that is being made; None without."""
        process, state = self._process, self._state
        if process is None or state is None:
            return None
        status = process.poll()
        if status and not self.notices:
            text = f"the recording has ended: {self._last_line()}"
            self.notices = [Cause.RECORDING_ENDED.notice(text, "recorder", time.time())]
        return state if status is None else None

    def start(self, has_joined: Callable[[], bool]) -> str:
        """Start a recording; return what was done, as soon as `has_joined` tells that messages come.

        Raises
        ------
        RunError
            If there is a recording already, or none begins.
        """
        with self._lock:
            if self.state is not None:
                raise RunError(f"a recording is being made: {self.state.path}")
            path = _free(self._folder, self._skin)
            command = ["record", str(path), "--no-frames", "--connect", self._endpoint, "--skin", self._skin]
            self._close_log()
            self._state = None  # until it has begun: a start that fails is told to who asked, in no notice
            self._log = tempfile.TemporaryFile()  # noqa: SIM115 - open while the process runs
            self._process = process = self._parent.submit(_launch, command, self._log).result()
            give_up_s = time.monotonic() + PATIENCE_S
            while not has_joined():
                if process.poll() is not None:
                    self._process = None
                    raise RunError(f"no recording: {self._last_line()}")
                if time.monotonic() > give_up_s:
                    process.kill()
                    process.wait()
                    self._process = None
                    raise RunError(f"no recording: it has not begun in {PATIENCE_S:g} s")
                time.sleep(_LOOK_S)
            self._state, self.notices = RecorderState(path=str(path), since_time_s=time.time()), []
            return f"recording to {path}"

    def stop(self) -> str:
        """End the recording; return what was recorded.

        Raises
        ------
        RunError
            If there is none, or it could not be ended well.
        """
        with self._lock:
            if self._process is None or self.state is None:
                raise RunError("no recording is being made")
            return self._end()

    def close(self) -> None:
        """End the recording, if there is one."""
        with self._lock:
            if self._process is not None and self._process.poll() is None:
                try:
                    say("viewer", self._end())
                except RunError as error:
                    say("viewer", str(error))
            self._close_log()
            self._parent.shutdown()

    def _end(self) -> str:
        process, self._process = self._process, None
        if process is None:
            return ""
        process.terminate()
        try:
            status = process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            process.kill()
            status = process.wait()
        if status:
            raise RunError(f"the recording has ended with status {status}: {self._last_line()}")
        return self._last_line()

    def _last_line(self) -> str:
        if self._log is None:
            return ""
        self._log.seek(0)
        lines = self._log.read().decode(errors="replace").strip().splitlines()
        return lines[-1].partition(": ")[2] if lines else "it said nothing"

    def _close_log(self) -> None:
        if self._log is not None:
            self._log.close()
            self._log = None


def _launch(arguments: list[str], log: IO[bytes]) -> subprocess.Popen[bytes]:
    return subprocess.Popen(  # noqa: S603 - our own command, no shell
        [sys.executable, "-m", "skin", f"--priority={given_priority().value}", *arguments],
        stdin=subprocess.DEVNULL,
        stdout=log,
        stderr=log,
        env={**os.environ, "SKIN_PARENT": str(os.getpid())},
        process_group=0,  # Ctrl-C reaches the page's server only, which ends the recording
    )


def _free(folder: Path, skin: str) -> Path:
    """Return the path of a new recording."""
    name = f"{skin}-{time.strftime('%Y%m%d-%H%M%S')}"
    path, number = folder / f"{name}{RECORDING_SUFFIX}", 1
    while path.exists():
        number += 1
        path = folder / f"{name}-{number}{RECORDING_SUFFIX}"
    return path
