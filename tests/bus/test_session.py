"""What one client of a bus gets, in which packets, and what is kept for a client that does not read."""

import numpy as np
import pytest

from bus.outbox import Events
from bus.session import Batch, Session
from bus.simulated_bus import SimulatedBus
from dbc.frame import ECHO, ERROR, FRAME, Frames
from tests.bus.harness import burst, frame

#: Audience of a record.
OTHERS, OWNER, BOTH = 1, 2, 3


class Client:
    """The far end of a connection, which reads or does not."""

    def __init__(self) -> None:
        self.reads = True
        self.headers: list[tuple[int, ...]] = []
        self.packets: list[Frames] = []

    def fileno(self) -> int:
        return 77

    def sendmsg(self, parts: tuple[bytes, bytes]) -> None:
        if not self.reads:
            raise BlockingIOError
        header, payload = parts
        assert header[:5] == b"CSK1\4"
        self.headers.append(
            tuple(int.from_bytes(header[a:b], "little") for a, b in ((5, 6), (6, 8), (8, 16), (16, 24)))
        )
        self.packets.append(np.frombuffer(payload, FRAME))

    @property
    def ids(self) -> list[int]:
        return [can_id for packet in self.packets for can_id in packet["can_id"].tolist()]


class Wire:
    """Two stations of a bus, the second of which is the client's."""

    def __init__(self) -> None:
        bus = SimulatedBus()
        self.other, self.station = bus.attach("other"), bus.attach("mine")
        self.client = Client()
        self.session = Session(self.client, self.station)  # type: ignore[arg-type]

    def give(self, sent: Frames, *, mine: bool = False, audience: int | list[int] = BOTH, now_ns: int = 5) -> None:
        owner = np.full(len(sent), (self.station if mine else self.other).number)
        audiences = np.broadcast_to(np.array(audience, np.uint8), len(sent))
        plain = bool((audiences == BOTH).all())
        self.session.offer(Batch(Events(sent, owner, audiences, plain)), now_ns)


def test_a_packet_tells_state_frames_losses_and_time() -> None:
    wire = Wire()
    wire.give(burst([0x100, 0x101]), now_ns=123_456_789_012)
    wire.session.backlog.dropped = 7
    wire.give(burst([0x102]), now_ns=3)
    assert wire.client.headers == [(0, 2, 0, 123_456_789_012), (0, 1, 7, 3)]
    assert wire.client.ids == [0x100, 0x101, 0x102]
    assert not wire.session.blocked
    assert wire.session.fileno() == 77


@pytest.mark.parametrize("mine", [False, True])
def test_a_packet_holds_512_frames_at_most(mine: bool) -> None:
    wire = Wire()
    for count in (512, 513, 1025, 0):
        wire.give(burst(range(count)), mine=mine)
    assert [len(packet) for packet in wire.client.packets] == [512, 512, 1, 512, 512, 1]
    assert [header[1] for header in wire.client.headers] == [512, 512, 1, 512, 512, 1]
    assert wire.client.ids == [*range(512), *range(513), *range(1025)]


@pytest.mark.parametrize("mine", [False, True])
def test_only_the_sender_sees_its_ports_and_echoes(mine: bool) -> None:
    wire, sent = Wire(), frame(0x181, b"\1", port=5)
    wire.give(sent, mine=mine)
    wire.give(np.concatenate([sent, frame(0x182, flags=ERROR, port=6)]), mine=mine, audience=[BOTH, OWNER])
    got = np.concatenate(wire.client.packets)
    if mine:
        assert got["flags"].tolist() == [ECHO, ECHO, ERROR]
        assert got["port"].tolist() == [5, 5, 6]
    else:
        assert got["flags"].tolist() == [0, 0]
        assert got["port"].tolist() == [0, 0]
    assert (sent["flags"].tolist(), sent["port"].tolist()) == ([0], [5])


def test_records_of_two_senders_stay_in_order() -> None:
    wire, sent = Wire(), burst([0x100, 0x101, 0x102, 0x103])
    sent["port"] = 3
    numbers = [wire.station.number, wire.other.number]
    owner, audience = np.array(numbers * 2), np.array([BOTH, BOTH, OWNER, OTHERS], np.uint8)
    wire.session.offer(Batch(Events(sent, owner, audience, plain=False)), 5)
    wire.session.offer(Batch(Events(sent, owner, np.full(4, BOTH, np.uint8), plain=True)), 5)
    assert wire.client.ids == 2 * [0x100, 0x101, 0x102, 0x103]
    got = np.concatenate(wire.client.packets)
    assert got["flags"].tolist() == 2 * [ECHO, 0, ECHO, 0]
    assert got["port"].tolist() == 2 * [3, 0, 3, 0]


def test_what_others_lost_or_were_told_alone_does_not_come() -> None:
    wire = Wire()
    wire.give(burst([0x100, 0x101, 0x102]), audience=[OWNER, OTHERS, BOTH])
    wire.give(burst([0x200, 0x201, 0x202]), mine=True, audience=[OWNER, OTHERS, BOTH])
    assert wire.client.ids == [0x101, 0x102, 0x200, 0x202]


def test_a_station_without_power_hears_only_of_its_own_frames() -> None:
    wire = Wire()
    wire.station.off = True
    wire.give(burst([0x100]))
    sent = np.concatenate([frame(0x200), frame(0x300)])
    owner = np.array([wire.station.number, wire.other.number])
    wire.session.offer(Batch(Events(sent, owner, np.full(2, BOTH, np.uint8), plain=True)), 5)
    assert wire.client.ids == [0x200]


def test_what_was_not_read_comes_later_in_order_and_nothing_overtakes_it() -> None:
    wire = Wire()
    wire.client.reads = False
    wire.give(burst(range(300)))
    assert wire.session.blocked
    wire.session.flush(6)
    assert wire.session.blocked
    wire.client.reads = True
    wire.give(burst(range(300, 500)))
    wire.give(burst(range(500, 600)), mine=True)
    assert wire.client.packets == []
    wire.session.flush(9)
    assert [header[1:] for header in wire.client.headers] == [(500, 0, 9), (100, 0, 9)]
    assert wire.client.ids == list(range(600))
    assert not wire.session.blocked


def test_16384_received_frames_are_kept_and_every_echo() -> None:
    wire, many = Wire(), burst([*range(512)] * 4)
    wire.client.reads = False
    for _ in range(7):
        wire.give(many)
    wire.give(many[:2047])
    assert wire.session.backlog.dropped == 0
    wire.give(many, mine=True)
    assert wire.session.backlog.dropped == 0
    wire.give(many[:3])
    assert wire.session.backlog.dropped == 2
    wire.give(many)
    assert wire.session.backlog.dropped == 2050
    wire.client.reads = True
    wire.session.flush(0)
    assert len(wire.client.ids) == 16_384 + 2048
    assert wire.client.headers[-1][2] == 2050
    wire.client.reads = False
    for _ in range(8):
        wire.give(many)
    assert wire.session.backlog.dropped == 2050  # all that was read makes room again
    wire.give(many[:1])
    assert wire.session.backlog.dropped == 2051
