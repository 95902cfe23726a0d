"""What the tests of the integrations share: a skin on a fabric, and one in this process whose clock the test moves."""

import importlib.util
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace

import msgspec
import numpy as np
import pytest

import canskin
from canskin.frame import Frame
from canskin.messages import CONTACTS, IMAGE, MEASUREMENT
from canskin.skin import FrameHub, Frames, Health, Skin
from tests.client.helpers import Chain, contacts, description, image, measurement

ROOT = Path(__file__).parents[3]
PACKAGE = ROOT / "client/lerobot_camera_canskin/lerobot_camera_canskin"
LATENCY_NS = 12_000_000
PERIOD_NS = 10_000_000


def load_window() -> ModuleType:
    """Return the module `window` of the package, which needs no LeRobot, though its package does."""
    if importlib.util.find_spec("lerobot") is not None:
        return importlib.import_module("lerobot_camera_canskin.window")
    spec = importlib.util.spec_from_file_location("lerobot_camera_canskin_window", PACKAGE / "window.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


class LiveChain(Chain):
    """Stand-ins for the services that send frames of this instant, every 5 ms."""

    def _send(self) -> None:
        cycle = 0
        while not self._stop.wait(0.005):
            cycle += 1
            self.publish(cycle)

    def publish(self, cycle: int, age_s: float = 0.0) -> None:
        sampled_ns = time.monotonic_ns() - int(age_s * 1e9)
        offset_ns = time.time_ns() - time.monotonic_ns()
        about = msgspec.structs.replace(measurement(cycle), wall_offset_ns=offset_ns, sampled_mono_ns=sampled_ns)
        self.gateway.publish(MEASUREMENT, about)
        self.gateway.publish(IMAGE, msgspec.structs.replace(image(cycle), sampled_mono_ns=sampled_ns))
        self.gateway.publish(CONTACTS, msgspec.structs.replace(contacts(cycle), sampled_mono_ns=sampled_ns))


@pytest.fixture
def live_chain(endpoint: str) -> Iterator[LiveChain]:
    made = LiveChain(endpoint)
    yield made
    made.close()


class ClockedSkin(Skin):
    """A skin of 4 x 4 taxels, 100 cycles a second, on a clock that the test moves; 12 ms from sampling to the frame."""

    start_ns = 1_000_000_000_000_000_000

    def __init__(self) -> None:
        super().__init__(description(), 0.1)
        self.now_ns = self.start_ns
        self.hub = FrameHub(0.1, lambda: "nothing came")
        self.cycle = 0
        self.silent: set[int] = set()
        self._closed = threading.Event()

    def frames(self, queue: int = 1) -> Frames:
        return self.hub.frames(queue)

    def advance(self, to_ns: int) -> int:
        """Move the clock to an instant after the start; return the newest cycle whose frame has come by then."""
        self.now_ns = self.start_ns + to_ns
        while self.sampled_ns(self.cycle + 1) + LATENCY_NS <= self.now_ns:
            self.cycle += 1
            if self.cycle not in self.silent:
                self.hub.put(frame(self.cycle, self.sampled_ns(self.cycle)))
        return self.cycle

    def sampled_ns(self, cycle: int) -> int:
        return self.start_ns + cycle * PERIOD_NS

    @property
    def health(self) -> Health:
        return Health(services=frozenset({"gateway"}), gateway=None, frames=self.hub.count, refused=0)

    def latest(self, max_age_s: float = 1.0) -> Frame:
        return self.hub.latest(max_age_s)

    def tare(self, *, force: bool = False, region: tuple[int, int, int, int] | None = None) -> str:
        raise NotImplementedError

    def close(self) -> None:
        self.hub.close()


def force_n(cycle: int) -> np.ndarray:
    """Return the forces of a cycle, 0 to 1 N, other ones in each of 1000 cycles."""
    return np.float32(((np.arange(16) * 61 + cycle) % 1000).reshape(4, 4) / 1000)


def valid(cycle: int) -> np.ndarray:
    """Return the validity of a cycle: each 7th lacks the odd taxels."""
    return (np.arange(16).reshape(4, 4) % 2 == 0) | (cycle % 7 != 0)


def frame(cycle: int, sampled_ns: int = 0) -> Frame:
    estimate, is_valid = force_n(cycle), valid(cycle)
    return Frame(
        forces=np.where(is_valid, estimate, np.float32(np.nan)).ravel(),
        estimate=estimate,
        valid=is_valid,
        doubtful=np.zeros_like(is_valid),
        sums=np.zeros(0, np.int32),
        valid_sums=np.zeros(0, np.bool_),
        contacts=(),
        ended=(),
        is_blind=False,
        label=None,
        confidence=0.0,
        cycle=cycle,
        sampled_at=sampled_ns * 1e-9,
        sampled_mono_ns=sampled_ns,
        sampled_error_s=0.0,
        _skin=description(),
    )


@pytest.fixture
def clocked(monkeypatch: pytest.MonkeyPatch) -> ClockedSkin:
    """Return a skin on a clock that the test moves; `canskin.connect` returns it."""
    skin = ClockedSkin()
    clock = SimpleNamespace(monotonic_ns=lambda: skin.now_ns, time=lambda: skin.now_ns * 1e-9)
    monkeypatch.setattr("canskin.frame.time", clock)
    monkeypatch.setattr("canskin.skin_clock.time", clock)
    monkeypatch.setattr(canskin, "connect", lambda *_where, **_how: skin)
    return skin
