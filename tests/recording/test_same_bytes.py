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
from dbc.contract import Contract
from dbc.frame import ECHO, Frames
from reconstructor.engine import Reconstructor
from reconstructor.service import ReconstructorService
from recording.sinks import Sink, open_sink
from skin.layout import layout_text
from tests.gateway.world import PERIOD_S, EndOfWire, World, small_contract
from tests.recording.conftest import OFFSET_NS
from tests.recording.test_replay import messages

#: Frames of a bus follow each other by so much, on the clock of the recorder.
FRAME_NS = 130_000
FORMATS = ("run.mcap", "run.log", "run.asc")


class Seen:
    """All that a gateway sees of a bus, as another station does: without marks of what the gateway sent itself."""

    def __init__(self, end: EndOfWire) -> None:
        self.new: list[Frames] = []
        self._newest_ns = 0
        self._receive = end.receive
        end.receive = self.receive  # type: ignore[method-assign]

    def receive(self) -> Frames:
        arrived = self._receive()
        mine = arrived.copy()
        mine["flags"] &= ~np.uint8(ECHO)
        for each in range(len(mine)):
            self._newest_ns = max(int(mine["time_ns"][each]), self._newest_ns + FRAME_NS)
            mine["time_ns"][each] = self._newest_ns
        self.new.append(mine)
        return arrived


class Recorded:
    """Publishes to files."""

    def __init__(self, sinks: list[Sink], world: World) -> None:
        self._sinks, self._world = sinks, world

    @property
    def now_ns(self) -> int:
        return round(self._world.now_s * 1e9) + OFFSET_NS

    def publish(self, topic: Topic, message: msgspec.Struct) -> None:
        for sink in self._sinks:
            sink.message(topic, self.now_ns, msgspec.msgpack.encode(message))

    def mailbox(self, topic: Topic, depth: int = 4) -> Mailbox[Any]:
        return Mailbox(depth)


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
def contract() -> Contract:
    return small_contract()


@pytest.fixture(scope="module")
def folder(contract: Contract, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Recordings of one run in all formats, and its layout."""
    folder = tmp_path_factory.mktemp("runs")
    (folder / "small.toml").write_text(layout_text(contract.layout))
    sinks = [open_sink(folder / name, contract, 1, OFFSET_NS) for name in FORMATS]
    rows, columns = contract.layout.taxels.rows, contract.layout.taxels.columns
    world = World(contract)
    seen = [Seen(wire.gateway) for wire in world.wires]
    live = Recorded(sinks, world)
    service = ReconstructorService(
        contract.layout, Reconstructor(contract.phi, rows, columns), live, clock_ns=lambda: 7
    )

    def run(seconds: float) -> None:
        for _ in range(round(seconds / world.step_s)):
            made = world.step()
            for bus, each in enumerate(seen):
                for arrived in each.new:
                    for sink in sinks:
                        sink.frames(bus, arrived, live.now_ns, OFFSET_NS)
                each.new.clear()
            for each in made:
                published = msgspec.structs.replace(each, wall_offset_ns=OFFSET_NS)
                live.publish(MEASUREMENT, published)
                service.take(published)

    run(1.0)
    late = Loss(sums_frame(world, 0, 1))
    world.wires[0].loses = late
    run(1.5 * PERIOD_S)  # the frame comes after the next SYNC
    world.wires[0].put(late.cob_id, late.kept)
    run(4 * PERIOD_S)
    world.wires[1].loses = Loss(sums_frame(world, 1, 2))
    run(10 * PERIOD_S)
    world.nmt(0, NmtCommand.RESET_NODE, 2)
    run(3.0)
    for sink in sinks:
        sink.close()
    return folder


def replayed(folder: Path, name: str) -> tuple[list[Measurement], list[Image]]:
    out = folder / f"{name}.again.mcap"
    offset = str(OFFSET_NS if name.endswith(".mcap") else 0)
    command = [sys.executable, "-m", "tests.recording.replaying", folder / name, out, offset, folder / "small.toml"]
    subprocess.run(command, check=True)
    return messages(out, MEASUREMENT), messages(out, IMAGE)


@pytest.mark.parametrize("name", FORMATS)
def test_same_bytes(folder: Path, name: str) -> None:
    measured, images = messages(folder / FORMATS[0], MEASUREMENT), messages(folder / FORMATS[0], IMAGE)
    invalid = np.array([list(each.valid) for each in measured]) == 0
    assert invalid.sum(axis=0).tolist() == [2, 2, 0, 2]  # late: its cycle and the next; reset; lost, and the next cycle
    again, images_again = replayed(folder, name)
    if name.endswith(".mcap"):
        assert again == measured
    assert [list(each.valid) for each in again] == [list(each.valid) for each in measured]
    assert [each.sums for each in again] == [each.sums for each in measured]
    assert [each.pixels for each in images_again] == [each.pixels for each in images]
