"""Stands in for systemd: starts services, watches them and starts them again as the unit in `deploy/` says."""

import array
import os
import re
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from tests.processes import PATIENCE_S

UNIT: Final = Path(__file__).parents[2] / "deploy/skin@.service"
NEVER_S: Final = float("inf")
#: Of one look at all units to the next.
LOOK_S: Final = 0.02
#: Process, user and group of a sender (unix(7)).
_SENDER: Final = struct.Struct("iII")


@dataclass
class Unit:
    """A service: its command, its process, and when its watchdog runs out."""

    name: str
    words: list[str]
    log: Path
    process: subprocess.Popen[bytes]
    is_ready: bool = False
    late_s: float = NEVER_S
    #: When its process was started last.
    launched_s: float = 0.0
    #: None while the process runs.
    again_s: float | None = None
    #: Exit status of each of its processes that ended.
    ends: list[int] = field(default_factory=list)


class Units:
    """Units of Type=notify (systemd.service(5)), in `folder`, whose environment gets more variables."""

    def __init__(self, folder: Path, **environment: str) -> None:
        self.units: dict[str, Unit] = {}
        settings = dict(re.findall(r"^(\w+)=(.*)$", UNIT.read_text(), re.MULTILINE))
        assert (settings["Type"], settings["Restart"]) == ("notify", "on-failure")
        self.watchdog_s, self._again_s = float(settings["WatchdogSec"]), float(settings["RestartSec"])
        self._folder = folder
        self._notes = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        self._notes.bind(str(folder / "notify"))
        self._notes.setsockopt(socket.SOL_SOCKET, socket.SO_PASSCRED, 1)
        self._environment = {
            **os.environ,
            "SKIN_BUS_DIR": str(folder),
            "SKIN_PARENT": str(os.getpid()),
            "NOTIFY_SOCKET": str(folder / "notify"),
            "WATCHDOG_USEC": str(round(1e6 * self.watchdog_s)),
            **environment,
        }
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._watch)
        self._thread.start()

    def start(self, name: str, *words: str) -> None:
        """Start a unit and wait until it is ready."""
        log = self._folder / f"{name}.log"
        self.units[name] = Unit(name, list(words), log, self._launch(words, log))
        self.until(lambda: self.units[name].is_ready, f"{name} to be ready")

    def skin(self, name: str, *words: str) -> None:
        """Start a unit of a verb."""
        self.start(name, sys.executable, "-m", "skin", *words)

    def hit(self, name: str, number: int) -> None:
        """Send the process of a unit a signal; the unit is not ready from now on."""
        unit = self.units[name]
        unit.is_ready = False
        os.kill(unit.process.pid, number)

    def until(self, is_so: Callable[[], bool], what: str) -> None:
        """Wait for something."""
        give_up_s = time.monotonic() + PATIENCE_S
        while not is_so():
            said = "\n".join(f"{name}: {unit.log.read_text(errors='replace')}" for name, unit in self.units.items())
            assert time.monotonic() < give_up_s, f"waited {PATIENCE_S:g} s in vain for {what}\n{said}"
            time.sleep(LOOK_S)

    def close(self) -> None:
        """End all units."""
        self._ends.set()
        self._thread.join()
        for unit in self.units.values():
            if unit.process.poll() is None:
                unit.process.kill()
            unit.process.wait()
        self._notes.close()

    def _launch(self, words: "list[str] | tuple[str, ...]", log: Path) -> subprocess.Popen[bytes]:
        with log.open("ab") as sink:
            return subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=sink, stderr=sink, env=self._environment)

    def _watch(self) -> None:
        while not self._ends.wait(LOOK_S):
            self._hear()
            for unit in list(self.units.values()):
                self._look(unit, time.monotonic())

    def _hear(self) -> None:
        while True:
            try:
                text, about, _, _ = self._notes.recvmsg(4096, socket.CMSG_SPACE(_SENDER.size))
            except BlockingIOError:
                return
            sender, _, _ = _SENDER.unpack(array.array("B", about[0][2]).tobytes())
            for unit in list(self.units.values()):
                if unit.process.pid == sender:
                    unit.is_ready |= text == b"READY=1"
                    unit.late_s = time.monotonic() + self.watchdog_s

    def _look(self, unit: Unit, now_s: float) -> None:
        status = unit.process.poll()
        if status is not None and unit.again_s is None:
            unit.is_ready = False
            unit.ends.append(status)
            unit.again_s = now_s + self._again_s if status else NEVER_S
        elif unit.again_s is not None and now_s >= unit.again_s:
            unit.process = self._launch(unit.words, unit.log)
            unit.late_s, unit.again_s, unit.launched_s = NEVER_S, None, now_s
        elif now_s >= unit.late_s:
            unit.late_s = NEVER_S
            # In this order, as systemd does for a process that may be stopped.
            unit.process.send_signal(signal.SIGABRT)
            unit.process.send_signal(signal.SIGCONT)
