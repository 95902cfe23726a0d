"""``skin`` services as processes of their own, for the tests that need the wires between them to be real."""

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Final

import pytest

PATIENCE_S: Final = 240.0
#: ``skin`` as a person types its arguments: exit code, output, errors (fixture ``skin``).
Verb = Callable[..., tuple[int, str, str]]


class Processes:
    """Starts processes, keeps what they say in `folder`, and ends them with the block."""

    def __init__(self, folder: Path, **environment: str) -> None:
        self.folder = folder
        self._environment = {**os.environ, "SKIN_BUS_DIR": str(folder), "SKIN_PARENT": str(os.getpid()), **environment}
        self._running: dict[str, subprocess.Popen[bytes]] = {}

    def __enter__(self) -> "Processes":  # noqa: PYI034 - the client's tests run on Python 3.10, too
        return self

    def __exit__(
        self, _kind: type[BaseException] | None, _error: BaseException | None, _trace: TracebackType | None
    ) -> None:
        # All are told at once and all are ended: what is left running with real-time priority starves the other tests.
        for process in self._running.values():
            if process.poll() is None:
                os.kill(_inside(process.pid), signal.SIGTERM)
        with ExitStack() as stack:
            for name in self._running:
                stack.callback(self.stop, name)

    def skin(self, name: str, *arguments: str) -> None:
        """Start ``skin ARGUMENTS``."""
        self.start(name, sys.executable, "-m", "skin", *arguments)

    def start(self, name: str, *command: str, environment: dict[str, str] | None = None) -> None:
        """Start any command; its words go to the log of `name`."""
        with self.log(name).open("wb") as log:
            self._running[name] = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                env={**self._environment, **(environment or {})},
            )

    def send_signal(self, name: str, number: int) -> None:
        """Send a process a signal."""
        self._running[name].send_signal(number)

    def stop(self, name: str, number: int = signal.SIGTERM) -> int:
        """End a process and return its exit status."""
        process = self._running.pop(name)
        if process.poll() is None:
            os.kill(_inside(process.pid), number)
        try:
            return process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            raise

    def number(self, name: str) -> int:
        """Return the number of a process."""
        return self._running[name].pid

    def runs(self, name: str) -> bool:
        """Tell whether a process was started, and not stopped since."""
        return name in self._running

    def peak_bytes(self, name: str) -> int:
        """Return the most memory that a process had so far, as Linux counts it."""
        about = Path("/proc", str(_inside(self._running[name].pid)), "status").read_text()
        return 1024 * next(int(line.split()[1]) for line in about.splitlines() if line.startswith("VmHWM"))

    def log(self, name: str) -> Path:
        """Return where the words of `name` are."""
        return self.folder / f"{name}.log"

    def await_words(self, name: str, words: str) -> None:
        """Wait until a process has said `words`."""
        self.until(lambda: words in self.log(name).read_text(errors="replace"), f"{name} to say '{words}'")

    def until(self, is_so: Callable[[], bool], what: str, every_s: float = 0.01) -> None:
        """Wait for something, but not longer than all processes live."""
        give_up_s = time.monotonic() + PATIENCE_S
        while not is_so():
            for name, process in self._running.items():
                if process.poll() is not None:
                    said = self.log(name).read_text(errors="replace")
                    pytest.fail(f"{name} ended with {process.returncode}: {said}")
            assert time.monotonic() < give_up_s, f"waited {PATIENCE_S:g} s in vain for {what}"
            time.sleep(every_s)


def _inside(process: int) -> int:
    """Return the process that a box of bubblewrap holds; for any other process, the process itself.

    A box that gets a signal kills the process.
    """
    about = Path("/proc", str(process))
    if not about.exists() or (about / "comm").read_text() != "bwrap\n":
        return process
    held = (about / "task" / str(process) / "children").read_text().split()
    return int(held[0]) if held else process


def free_port() -> int:
    """Return a port of this machine that nobody uses now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def free_endpoint() -> str:
    """Return an endpoint for a hub on this machine that nobody uses now."""
    return f"tcp/127.0.0.1:{free_port()}"
