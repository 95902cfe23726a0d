"""A skin of 16 boards beside eight drives on one bus with arbitration and exact bit times, in one thread."""

import struct
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from bus.link import Send
from bus.outbox import OTHERS, OWNER
from bus.simulated_bus import SimulatedBus
from bus.station import Station
from dbc.canopen import EMCY_BASE, HEARTBEAT_BASE, SDO_REQUEST_BASE, SDO_RESPONSE_BASE, NmtState
from dbc.contract import Contract
from dbc.frame import ECHO, Frames, frames
from tests.bus.harness import frame
from tests.layouts import small_layout
from tests.world import EndOfWire, Wire, World

DRIVES: Final = range(1, 9)
#: SYNC of the drives' controller, moved by 1005h.
THEIR_SYNC: Final = 0x0F0
#: Of each drive: name, identifier less the node-ID, bytes, period.
MESSAGES: Final = (
    ("emcy", EMCY_BASE, 8, 0.1),
    ("status", 0x180, 8, 0.01),
    ("target", 0x200, 6, 0.01),
    ("sdo_response", SDO_RESPONSE_BASE, 8, 0.04),
    ("sdo_request", SDO_REQUEST_BASE, 8, 0.04),
    ("heartbeat", HEARTBEAT_BASE, 1, 0.1),
)
#: The drive that also sends SYNC of the skin's identifier in some tests.
OTHER_PRODUCER: Final = 3


def foreign() -> list[dict[str, Any]]:
    """Return the messages of the drives, as tables of a layout."""
    of_drives = [
        {"name": f"drive{drive}.{name}", "identifier": base + drive, "length": length, "period_s": period_s}
        for drive in DRIVES
        for name, base, length, period_s in MESSAGES
    ]
    return [{"name": "motion.sync", "identifier": THEIR_SYNC, "length": 0, "period_s": 0.01}, *of_drives]


def shared_contract(**bus: Any) -> Contract:
    """Return a skin of 512 taxels on 16 boards, node-IDs 33 to 48, on the bus of the drives."""
    table = {"name": "can0", "nodes": 16, "first_node_id": 33, "foreign": foreign()} | bus
    return Contract.from_layout(small_layout(16, 32, measurement={"sums": 128}, sync={"rate_hz": 100}, bus=[table]))


class SharedWire(Wire):
    """A bus with arbitration, on which others than gateway and boards may be."""

    def __init__(self, bitrate: int = 1_000_000, seed: int = 0) -> None:
        super().__init__()
        self.bus = SimulatedBus(bitrate, seed=seed)
        self._stations: dict[EndOfWire | None, Station] = {
            self.gateway: self.bus.attach("gateway"),
            self.nodes: self.bus.attach("nodes"),
            None: self.bus.attach("others"),
        }
        self._takes = [(self._stations[end], end.arrive) for end in (self.gateway, self.nodes)]

    def join(self, name: str, take: Callable[[Frames], object]) -> Send:
        """Connect a station; return what sends its frames."""
        station = self.bus.attach(name, queue_size=100_000)
        self._takes.append((station, take))
        return lambda burst: self.bus.submit(station, burst, self.now_ns)

    def deliver(self) -> bool:
        sent, self.queue = self.queue, []
        for sender, burst in sent:
            self.bus.submit(self._stations[sender], burst, self.now_ns)
        ended = self.bus.run_until(self.now_ns)
        for station, take in self._takes:
            is_own = ended.owner == station.number
            is_mine = ended.audience & np.where(is_own, OWNER, OTHERS) != 0
            copy = ended.frames[is_mine].copy()
            copy["flags"][is_own[is_mine]] |= ECHO
            if len(copy):
                take(copy)
        return bool(len(ended.frames))


class Drives:
    """Eight drives and their controller: their frames come by the clock, and they answer SDO uploads."""

    def __init__(self, wire: SharedWire) -> None:
        self._ended_ns: dict[int, list[int]] = {}
        self._released_ns: dict[int, list[int]] = {}
        self._send = wire.join("drives", self._take)

    def send_for(self, begin_s: float, seconds: float, seed: int) -> None:
        """Queue all frames of some time, each message from a moment of its own on."""
        random = np.random.default_rng(seed)
        for port, each in enumerate(foreign()):
            releases_s = np.arange(random.uniform(0, each["period_s"]), seconds, each["period_s"])
            burst = frames(len(releases_s))
            burst["can_id"], burst["length"], burst["port"] = each["identifier"], each["length"], port
            burst["data"][:, : each["length"]] = random.integers(0, 256, (len(burst), each["length"]))
            if each["name"].endswith("heartbeat"):
                burst["data"][:, 0] = NmtState.OPERATIONAL
            burst["time_ns"] = np.rint((begin_s + releases_s) * 1e9)
            self._released_ns[each["identifier"]] = burst["time_ns"].tolist()
            assert self._send(burst) == len(burst)

    def worst_ms(self) -> dict[int, float]:
        """Return the longest time from the release of a frame to its end, by identifier; every frame has ended."""
        return {
            identifier: max(
                (end - release) * 1e-6 for release, end in zip(released, self._ended_ns[identifier], strict=True)
            )
            for identifier, released in self._released_ns.items()
        }

    def _take(self, arrived: Frames) -> None:
        for each in arrived:
            identifier = int(each["can_id"])
            if each["flags"] & ECHO:
                self._ended_ns.setdefault(identifier, []).append(int(each["time_ns"]))
            elif identifier - SDO_REQUEST_BASE in DRIVES and each["data"][0] == 0x40:
                self._answer(identifier - SDO_REQUEST_BASE, each["data"].tobytes())

    def _answer(self, drive: int, request: bytes) -> None:
        index, sub = struct.unpack_from("<HB", request, 1)
        sync = 0x4000_0080 if drive == OTHER_PRODUCER else THEIR_SYNC
        objects = {
            (0x1000, 0): b"\x92\x01\x02\x00",
            (0x1005, 0): struct.pack("<I", sync),
            (0x1008, 0): b"axis",
            (0x1018, 1): struct.pack("<I", 0x1A),
            (0x1018, 4): struct.pack("<I", 1000 + drive),
        }
        found = objects.get((index, sub))
        head, data = (0x43, found) if found is not None else (0x80, struct.pack("<I", 0x0602_0000))
        # Not by a controller of a message that comes by the clock.
        self._send(frame(SDO_RESPONSE_BASE + drive, bytes((head,)) + request[1:4] + data, port=200 + drive))


class SharedWorld(World):
    """The skin beside the drives; boards and gateway look at the bus every 0.5 ms."""

    step_s = 0.0005
    wire = SharedWire

    @property
    def shared(self) -> SharedWire:
        """The bus."""
        (wire,) = self.wires
        assert isinstance(wire, SharedWire)
        return wire
