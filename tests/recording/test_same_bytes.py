"""A recorded run with losses, late frames and a reset gives the same bytes, in another process, from any format."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from canskin.fabric import Mailbox
from canskin.messages import IMAGE, MEASUREMENT, Image, Measurement, Topic
from dbc.canopen import NmtCommand
from dbc.frame import ECHO, Frames
from reconstructor.imaging import make_imager
from reconstructor.service import ReconstructorService
from recording.sinks import open_sink
from skin.layout import layout_text
from tests.gateway.boards import BoardWorld
from tests.layouts import small_contract
from tests.recording.helpers import OFFSET_NS, messages_of
from tests.world import PERIOD_S, EndOfWire, World

#: Time between two frames of a bus on the clock of the recorder.
FRAME_NS = 130_000
FORMATS = ("run.mcap", "run.log", "run.asc")


class Seen:
    """All that a gateway sees of a bus, as another station does: without marks of what the gateway sent itself."""

    def __init__(self, end: EndOfWire, frame_ns: int) -> None:
        self.new: list[Frames] = []
        self._newest_ns, self._frame_ns = 0, frame_ns
        self._receive = end.receive
        end.receive = self.receive  # type: ignore[method-assign]

    def receive(self) -> Frames:
        arrived = self._receive()
        mine = arrived.copy()
        mine["flags"] &= ~np.uint8(ECHO)
        for each in range(len(mine)):
            self._newest_ns = max(int(mine["time_ns"][each]), self._newest_ns + self._frame_ns)
            mine["time_ns"][each] = self._newest_ns
        self.new.append(mine)
        return arrived


class Recorded:
    """A run with its reconstructor, recorded in files; an `Exchange` of the reconstructor."""

    def __init__(self, world: World | BoardWorld, files: list[Path], frame_ns: int) -> None:
        self._world, skin = world, world.contract.layout
        self.sinks = [open_sink(path, world.contract, 1, OFFSET_NS) for path in files]
        self._seen = [Seen(wire.gateway, frame_ns) for wire in world.wires]
        self._service = ReconstructorService(skin, make_imager(skin), self, clock_ns=lambda: 7)
        self.is_on = True

    @property
    def now_ns(self) -> int:
        return round(self._world.now_s * 1e9) + OFFSET_NS

    def publish(self, topic: Topic, message: msgspec.Struct) -> None:
        for sink in self.sinks if self.is_on else ():
            sink.message(topic, self.now_ns, msgspec.msgpack.encode(message))

    def mailbox(self, topic: Topic, depth: int = 4) -> Mailbox[Any]:
        return Mailbox(depth)

    def step(self) -> None:
        made = self._world.step()
        for bus, seen in enumerate(self._seen):
            for arrived in seen.new:
                for sink in self.sinks if self.is_on else ():
                    sink.frames(bus, arrived, self.now_ns, OFFSET_NS)
            seen.new.clear()
        for each in made:
            published = msgspec.structs.replace(each, wall_offset_ns=OFFSET_NS)
            self.publish(MEASUREMENT, published)
            self._service.take(published)

    def close(self) -> None:
        for sink in self.sinks:
            sink.close()


def sums_frame(world: World, bus: int, place: int) -> int:
    """Return the identifier of a frame with sums."""
    return int(world.contract.table.cob_id[world.contract.table.bus == bus][place])


class Loss:
    """Loses one frame of an identifier, and keeps it."""

    def __init__(self, cob_id: int) -> None:
        self.cob_id, self.kept = cob_id, None

    def __call__(self, end: EndOfWire, each: np.void) -> bool:
        if int(each["can_id"]) != self.cob_id or end is not end.wire.gateway or self.kept is not None:
            return False
        self.kept = each["data"][: each["length"]].tobytes()
        return True


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Recordings of one run in all formats, and its layout."""
    folder = tmp_path_factory.mktemp("runs")
    world = World(small_contract())
    (folder / "small.toml").write_text(layout_text(world.contract.layout))
    recorded = Recorded(world, [folder / name for name in FORMATS], FRAME_NS)

    def run(seconds: float) -> None:
        for _ in range(round(seconds / world.step_s)):
            recorded.step()

    run(1.0)
    late = Loss(sums_frame(world, 0, 1))
    world.wires[0].loses = late
    run(2 * PERIOD_S)  # the frame comes after its cycle has been measured
    world.wires[0].put(late.cob_id, late.kept)
    run(3.5 * PERIOD_S)
    world.wires[1].loses = Loss(sums_frame(world, 1, 2))
    run(10 * PERIOD_S)
    world.nmt(0, NmtCommand.RESET_NODE, 2)
    run(3.0)
    recorded.close()
    return folder


def replayed(folder: Path, name: str) -> tuple[list[Measurement], list[Image]]:
    out = folder / f"{name}.again.mcap"
    offset = str(OFFSET_NS if name.endswith(".mcap") else 0)
    command = [sys.executable, "-m", "tests.recording.replaying", folder / name, out, offset, folder / "small.toml"]
    subprocess.run(command, check=True)
    return messages_of(out, MEASUREMENT), messages_of(out, IMAGE)


@pytest.mark.heavy
@pytest.mark.parametrize("name", FORMATS)
def test_same_bytes(folder: Path, name: str) -> None:
    measured, images = messages_of(folder / FORMATS[0], MEASUREMENT), messages_of(folder / FORMATS[0], IMAGE)
    invalid = np.array([list(each.valid) for each in measured]) == 0
    assert invalid.sum(axis=0).tolist() == [1, 2, 0, 1]  # late: its cycle; reset; lost
    again, images_again = replayed(folder, name)
    if name.endswith(".mcap"):
        assert again == measured
    assert [list(each.valid) for each in again] == [list(each.valid) for each in measured]
    assert [each.sums for each in again] == [each.sums for each in measured]
    assert [each.pixels for each in images_again] == [each.pixels for each in images]
