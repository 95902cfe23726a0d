"""The processes of a run: started in the order of the data, watched, restarted, ended."""

import os
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from canskin.errors import InputError, RunError
from demo.processor_time import ProcessorTime, processor_time
from shell.command import WRONG_INPUT
from shell.service import given_priority, ordinary_scheduling

#: A process that has ended is started again after this time; the page shows its absence until then.
RESTART_AFTER_S: Final = 0.5
STOP_PATIENCE_S: Final = 5.0
#: Time limit for the end of all services when the user waits.
HASTE_S: Final = 1.0


@dataclass
class Child:
    """One service of the run."""

    name: str
    arguments: list[str]
    log: Path
    process: subprocess.Popen[bytes]
    restart: bool
    ended_at_s: float | None = None


@dataclass
class Supervisor:
    """Starts ``skin`` services as processes; `folder` holds their logs and the buses' sockets.

    `environment` is added to that of this process.
    """

    folder: Path
    environment: dict[str, str] = field(default_factory=dict)
    children: dict[str, Child] = field(default_factory=dict)

    def start(self, name: str, *arguments: str, restart: bool = False) -> Child:
        """Start ``skin ARGUMENTS`` as `name`; a service that has ended may have had the same name."""
        if name in self.children:
            self.children[name].process.wait(STOP_PATIENCE_S)
        log = self.folder / f"{name}.log"
        child = Child(name, list(arguments), log, self._launch(list(arguments), log), restart)
        self.children[name] = child
        return child

    def look(self, *, starting: bool = False) -> list[str]:
        """Restart services that have ended and may be restarted, but not while `starting`; return one line per event.

        Raises
        ------
        InputError
            If a service ended because of wrong input; the message is the service's own line.
        RunError
            If a service ended that the run needs, or that was not ready yet.
        """
        events = []
        for child in self.children.values():
            status = child.process.poll()
            if status is None:
                continue
            if status == WRONG_INPUT:
                raise InputError(self.last_line(child).removeprefix("skin: "))
            if starting or not child.restart:
                raise RunError(f"{child.name} ended (status {status}): {self.last_line(child)}")
            if child.ended_at_s is None:
                child.ended_at_s = time.monotonic()
                events.append(f"{child.name} ended (status {status})")
            elif time.monotonic() - child.ended_at_s >= RESTART_AFTER_S:
                child.process = self._launch(child.arguments, child.log)
                child.ended_at_s = None
                events.append(f"{child.name} started again as process {child.process.pid}")
        return events

    def processor_times(self) -> dict[str, ProcessorTime]:
        """Return the processor time of each service that runs, where the system tells it."""
        found = {name: processor_time(child.process.pid) for name, child in self.children.items()}
        return {name: each for name, each in found.items() if each is not None}

    def stop(self, *names: str) -> None:
        """End services, by default all, in the given order; kill services that do not end in time."""
        for child in [self.children[name] for name in names or self.children if name in self.children]:
            child.restart = False
            if child.process.poll() is None:
                child.process.terminate()
                try:
                    child.process.wait(STOP_PATIENCE_S)
                except subprocess.TimeoutExpired:
                    child.process.kill()
                    child.process.wait()

    def stop_at_once(self) -> None:
        """End all services at once; kill services that do not end in time."""
        for child in self.children.values():
            child.restart = False
            if child.process.poll() is None:
                child.process.terminate()
        give_up_s = time.monotonic() + HASTE_S
        for child in self.children.values():
            try:
                child.process.wait(max(0.0, give_up_s - time.monotonic()))
            except subprocess.TimeoutExpired:  # the service is still starting
                child.process.kill()
                child.process.wait()

    @staticmethod
    def last_line(child: Child) -> str:
        """Return the last log line of the service."""
        lines = child.log.read_text(errors="replace").strip().splitlines()
        return lines[-1] if lines else "it said nothing"

    def _launch(self, arguments: list[str], log: Path) -> subprocess.Popen[bytes]:
        # One thread per service: the services share the machine, and one thread is enough.
        added = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1") | self.environment
        environment = {**os.environ, **added, "SKIN_BUS_DIR": str(self.folder), "SKIN_PARENT": str(os.getpid())}
        with log.open("ab") as sink, ordinary_scheduling():
            return subprocess.Popen(  # noqa: S603 - our own command, no shell
                [sys.executable, "-m", "skin", f"--priority={given_priority().value}", *arguments],
                stdin=subprocess.DEVNULL,
                stdout=sink,
                stderr=sink,
                env=environment,
                process_group=0,  # Ctrl-C reaches this process only, which ends the others in order
            )
