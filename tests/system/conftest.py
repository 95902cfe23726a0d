"""A whole skin of real processes, at a SYNC rate that a busy machine carries."""

import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from canskin.fabric import Fabric
from canskin.messages import GATEWAY, IMAGE, LABEL, MEASUREMENT, GatewayStatus, Image, Label, Measurement
from demo.supervisor import Supervisor
from shell.command import main
from skin.layout import load_layout
from tests import layouts
from tests.processes import PATIENCE_S, free_endpoint


@pytest.fixture(scope="session")
def slow_layout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The default skin with 20 cycles a second."""
    return layouts.slow_layout(tmp_path_factory.mktemp("layout"), 20)


class Chain:
    """Services as processes, and what they publish."""

    def __init__(self, layout: Path, folder: Path) -> None:
        self.layout_path = layout
        self.layout = load_layout(layout)
        self.phi = self.layout.phi()
        self.supervisor = Supervisor(folder)
        self.endpoint = free_endpoint()
        self.fabric = Fabric(self.layout.name, "test", self.endpoint, hub=True)
        self.measurements: list[Measurement] = []
        self.images: list[Image] = []
        self.labels: list[Label] = []
        self.gateway: GatewayStatus | None = None
        self.alive: set[str] = set()
        self._news = threading.Condition()
        self.fabric.subscribe(MEASUREMENT, self._keep(self.measurements.append))
        self.fabric.subscribe(IMAGE, self._keep(self.images.append))
        self.fabric.subscribe(LABEL, self._keep(self.labels.append))
        self.fabric.subscribe(GATEWAY, self._keep(lambda status: setattr(self, "gateway", status)))
        self.fabric.watch(self._lives)

    def start(self, name: str, verb: str, *arguments: str) -> int:
        """Start a service that joins the fabric, and return its process."""
        common = () if verb == "bus" else ("--connect", self.endpoint)
        return self.supervisor.start(name, verb, *arguments, "--layout", str(self.layout_path), *common).process.pid

    def start_bus(self, *arguments: str) -> None:
        self.start("bus", "bus", *arguments)
        self.await_words("bus", "ready")

    def await_words(self, name: str, words: str) -> None:
        """Wait until a service has said `words`."""
        log = self.supervisor.children[name].log
        self.poll(f"{name}: {words}", lambda: words in log.read_text())

    def poll(self, what: str, holds: Callable[[], bool]) -> None:
        """Wait until something holds of which no message tells."""
        give_up_s = time.monotonic() + PATIENCE_S
        while not holds():
            if time.monotonic() > give_up_s:
                self._fail(what)
            time.sleep(0.05)

    def until(self, what: str, holds: Callable[[], bool]) -> None:
        """Wait until something holds; it is looked at whenever a message comes."""
        with self._news:
            if not self._news.wait_for(holds, PATIENCE_S):
                self._fail(what)

    def until_alive(self, *services: str) -> None:
        self.until(f"alive: {', '.join(services)}", lambda: self.alive >= set(services))

    def next_measurements(self, count: int) -> list[Measurement]:
        """Wait for `count` measurements that are yet to come, and return them."""
        first = len(self.measurements)
        self.until(f"{count} measurements", lambda: len(self.measurements) >= first + count)
        return self.measurements[first : first + count]

    def close(self) -> None:
        self.supervisor.stop()
        self.fabric.close()

    def _fail(self, what: str) -> None:
        logs = "\n".join(f"{one.name}: {one.log.read_text()}" for one in self.supervisor.children.values())
        pytest.fail(f"in {PATIENCE_S:g} s: not {what}\n{logs}")

    def _keep(self, use: Callable[..., None]) -> Callable[..., None]:
        def handler(message: object) -> None:
            with self._news:
                use(message)
                self._news.notify_all()

        return handler

    def _lives(self, name: str, alive: bool) -> None:
        with self._news:
            self.alive.add(name) if alive else self.alive.discard(name)
            self._news.notify_all()


def invalid_blocks(measurement: Measurement) -> list[int]:
    return [int(block) for block in np.flatnonzero(np.frombuffer(measurement.valid, np.uint8) == 0)]


@pytest.fixture
def chain(slow_layout: Path, tmp_path: Path) -> Iterator[Chain]:
    made = Chain(slow_layout, tmp_path)
    yield made
    made.close()


@pytest.fixture
def own_signals() -> Iterator[None]:
    """Give this process back what it does at a signal."""
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in handlers.items():
        signal.signal(number, handler)


#: Runs ``skin`` with arguments, as a process does.
Command = Callable[..., "subprocess.CompletedProcess[str]"]


@pytest.fixture
def command(
    own_signals: None, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> Command:
    """``skin`` in this process, with the virtual buses of `tmp_path`."""
    monkeypatch.setenv("SKIN_BUS_DIR", str(tmp_path))

    def run(*arguments: str) -> "subprocess.CompletedProcess[str]":
        monkeypatch.setattr(sys, "argv", ["skin", *arguments])
        capfd.readouterr()
        with pytest.raises(SystemExit) as ended:
            main()
        return subprocess.CompletedProcess(sys.argv, int(ended.value.code or 0), *capfd.readouterr())

    return run
