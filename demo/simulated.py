"""`canskin.simulate`: sums, images, contacts and labels of a simulated skin, in one process and without a bus."""

import asyncio
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec

from canskin.calibration_messages import Region
from canskin.errors import InputError
from canskin.fabric import Mailbox
from canskin.frame import Frame, FrameBuilder
from canskin.messages import Topic
from canskin.skin import Frames, Health, Skin
from classifier.cache import find_or_train
from classifier.decide import Classifier
from classifier.service import ClassifierService
from nodes.simulated import REST_S, Nodes
from reconstructor.imaging import make_imager
from reconstructor.service import ReconstructorService, warm_up
from shell.clock import wall_offset
from skin.description import describe
from skin.layout import Layout, load_layout, require_sending
from skin.sources import DEFAULT_OBJECTS, known_objects, load_objects, object_names, step_rate_hz


def simulate(layout: str | None = None, *, objects: Sequence[str] | None = None, seed: int = 0) -> "SimulatedSkin":
    """Return a simulated skin, not one of steps; see `canskin.simulate`."""
    if isinstance(objects, str):
        raise InputError(f"objects: expected a list of names, such as ['{objects}'], got '{objects}'")
    skin = load_layout(None if layout is None else Path(layout))
    require_sending(skin, "synchronous", "simulate() is", "use 'skin demo'")
    if objects is not None and not objects:
        raise InputError("objects: expected a list of names, got an empty list")
    return SimulatedSkin(skin, list(object_names(objects or DEFAULT_OBJECTS)), seed)


class _Messages:
    """Keeps what the services publish: a `canskin.fabric.Exchange`."""

    def __init__(self) -> None:
        self.kept: list[msgspec.Struct] = []

    def publish(self, _topic: Topic, message: msgspec.Struct) -> None:
        """Keep a message."""
        self.kept.append(message)

    def mailbox(self, _topic: Topic, depth: int = 4) -> Mailbox[Any]:
        """Return a mailbox that stays empty: services are called."""
        return Mailbox(depth)


class SimulatedSkin(Skin):
    """Computes a cycle whenever a frame is read."""

    def __init__(self, skin: Layout, objects: list[str], seed: int) -> None:
        super().__init__(describe(skin), float("inf"))
        phi = skin.phi()
        imager = make_imager(skin)
        warm_up(skin, imager)
        source = load_objects(skin, names=objects, seed=seed, rest_s=REST_S)
        self._nodes = Nodes(skin, source, seed=seed, clock_ns=time.monotonic_ns)
        self._messages = _Messages()
        self._reconstructor = ReconstructorService(skin, imager, self._messages)
        trained = find_or_train(skin, phi, known_objects(objects))
        self._classifier = ClassifierService(Classifier(trained, phi), skin, self._messages, keeps_time=False)
        self._builder = FrameBuilder(self.layout)
        self._lock = threading.Lock()
        for _ in range(round(REST_S * step_rate_hz(skin))):
            self._nodes.sample()
        self._nodes.cycle = 0  # the first frame is that of cycle 1
        self.is_closed = False

    def frames(self, queue: int = 1) -> Frames:
        """Return the frames of all cycles from now on; `queue` has no effect, because none waits."""
        del queue
        return _Steps(self)

    def latest(self, max_age_s: float = 1.0) -> Frame:
        """Return the frame of the next cycle."""
        del max_age_s
        return self.step()

    def step(self) -> Frame:
        """Compute the next cycle."""
        with self._lock:
            made = self._nodes.measurement(self._nodes.sample())
            measurement = msgspec.structs.replace(made, wall_offset_ns=wall_offset().ns)
            label = self._classifier.label(measurement)
            self._messages.kept = [measurement] if label is None else [measurement, label]
            self._reconstructor.take(measurement)
            return [frame for message in self._messages.kept for frame in self._builder.take(message)][-1]

    def tare(self, *, force: bool = False, region: Region | str | None = None) -> str:
        """Do nothing: simulated sums have no offsets."""
        del force, region
        return "a simulated skin has no offsets"

    @property
    def health(self) -> Health:
        """All is well."""
        return Health(services=frozenset({"simulation"}), gateway=None, frames=self._nodes.cycle, refused=0)

    def close(self) -> None:
        """End all iterations."""
        self.is_closed = True


class _Steps(Frames):
    """Computes each frame when it is read."""

    def __init__(self, skin: SimulatedSkin) -> None:
        super().__init__(1, float("inf"), str)
        self._skin = skin
        self._is_ended = False

    def close(self) -> None:
        """End the iteration."""
        self._is_ended = True

    def __next__(self) -> Frame:
        if self._is_ended or self._skin.is_closed:
            raise StopIteration
        return self._skin.step()

    async def __anext__(self) -> Frame:
        if self._is_ended or self._skin.is_closed:
            raise StopAsyncIteration
        return await asyncio.to_thread(self._skin.step)
