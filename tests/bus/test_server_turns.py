"""The process of a bus turn by turn: whom it takes in, whom it shows out, and when it wakes."""

import socket
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from random import Random
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest

from bus.faults import Fault
from bus.protocol import HEADER, Kind, pack, socket_path
from bus.server import BusServer, BusSettings
from dbc.frame import FRAME
from tests.bus.harness import burst, frame


class Desk:
    """A server whose turns the test takes, and its clients."""

    def __init__(self, stack: ExitStack, *channels: str, **settings: Any) -> None:
        self.stack = stack
        self.server = stack.enter_context(BusServer(channels or ["bus0"], BusSettings(**settings)))

    def client(self, hello: bytes | None = None) -> socket.socket:
        one = self.stack.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET))
        one.settimeout(10.0)
        one.connect(str(socket_path("bus0")))
        self.server.turn()
        if hello is not None:
            self.send(one, pack(Kind.HELLO, hello))
        return one

    def member(self, hello: bytes = b'{"name":"a"}') -> socket.socket:
        one = self.client(hello)
        assert one.recv(1000)[4] == 2
        return one

    def send(self, one: socket.socket, packet: bytes) -> None:
        one.send(packet)
        self.server.turn()

    @property
    def sessions(self) -> list[str]:
        return [session.station.name for session in self.server._lines[0].sessions]


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as made:
        yield made


def test_a_welcome_tells_how_the_bus_runs(stack: ExitStack) -> None:
    one = Desk(stack).client(b'{"name":"a"}')
    assert msgspec.json.decode(one.recv(1000)[24:]) == {
        "bitrate": 1_000_000, "data_bitrate": 5_000_000, "virtual_clock": False, "queue_size": 256
    }  # fmt: skip
    assert BusSettings().restart_s == 0.1


@pytest.mark.parametrize(
    ("hello", "reason"),
    [
        (b'{"name":"a","bitrate":500000}', "it runs at 1000000 bit/s, not 500000"),
        (b'{"name":"a","fd":true}', "it has no CAN FD: start it with --data-bitrate"),
        (b"{", "not understood: "),
    ],
)
def test_a_client_that_does_not_fit_is_told_why_and_shown_out(stack: ExitStack, hello: bytes, reason: str) -> None:
    desk = Desk(stack, data_bitrate=None)
    one = desk.client(hello)
    answer = one.recv(1000)
    assert answer[4] == 3
    assert answer[24:].decode().startswith(reason)
    assert one.recv(1000) == b""
    assert (desk.sessions, desk.server._lines[0].pending) == ([], [])


@pytest.mark.parametrize(
    "hello",
    [b'{"name":"a","data_bitrate":2000000}', b'{"name":"a","bitrate":1000000,"fd":true,"data_bitrate":5000000}'],
)
def test_rates_that_are_not_used_or_are_those_of_the_bus_do_not_matter(stack: ExitStack, hello: bytes) -> None:
    Desk(stack).member(hello)


def test_a_greeting_is_no_other_packet(stack: ExitStack) -> None:
    desk = Desk(stack)
    one = desk.client()
    desk.send(one, pack(Kind.FAULTS, b"[]"))
    assert one.recv(1000)[24:] == b"not understood: expected a greeting, got a packet of kind 5"


def test_there_is_room_for_so_many_clients_greeted_or_not(stack: ExitStack, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("bus.server.MAX_CLIENTS", 2)
    desk = Desk(stack)
    member, waiting, late = desk.member(), desk.client(), desk.client()
    assert late.recv(1000)[24:] == b"more than 2 clients"
    desk.send(waiting, pack(Kind.HELLO, b'{"name":"b"}'))
    assert waiting.recv(1000)[4] == 2
    member.close()
    desk.server.turn()
    assert desk.sessions == ["b"]
    desk.member()


@pytest.mark.parametrize(
    ("packet", "why"),
    [
        (pack(Kind.WELCOME), "a packet of kind 2"),
        (pack(Kind.FRAMES, burst(range(257)).tobytes(), count=257), "more frames than its transmit queue holds"),
        (
            pack(Kind.FRAMES, frame(0x800).tobytes(), count=1),
            "frame 0 (identifier 0x800) has an identifier that does not fit its format",
        ),
        (b"x", "a packet of 1 bytes"),
    ],
)
def test_a_client_that_breaks_the_protocol_is_shown_out_in_one_line(
    stack: ExitStack, capsys: pytest.CaptureFixture[str], packet: bytes, why: str
) -> None:
    desk = Desk(stack)
    bad, good = desk.member(b'{"name":"bad"}'), desk.member(b'{"name":"good"}')
    desk.send(bad, packet)
    assert capsys.readouterr().err == f"bus: bus0: client 'bad' disconnected: {why}\n"
    assert bad.recv(1000) == b""
    assert desk.sessions == ["good"]
    good.close()
    desk.server.turn()
    assert (desk.sessions, capsys.readouterr().err) == ([], "")
    assert desk.server.buses["bus0"].next_event_ns() is None


def test_a_listener_hears_and_sends_nothing(stack: ExitStack) -> None:
    desk = Desk(stack, virtual_clock=True)
    one, _, listener = desk.member(), desk.member(), desk.member(b'{"name":"ears","listen_only":true}')
    desk.send(one, pack(Kind.FRAMES, frame(0x123).tobytes(), count=1))
    heard = listener.recv(1000)
    assert HEADER.unpack_from(heard)[1:5] == (4, 0, 1, 0)
    assert len(heard) == 24 + FRAME.itemsize
    desk.send(listener, pack(Kind.FRAMES, frame(0x124).tobytes(), count=1))
    assert listener.recv(1000) == b""
    assert desk.sessions == ["a", "a"]


def test_each_bus_has_faults_and_random_numbers_of_its_own(stack: ExitStack) -> None:
    desk = Desk(stack, "bus0", "bus1", seed=7, faults=[Fault(loss_ratio=0.5)])
    assert [bus._faults._random.getstate() for bus in desk.server.buses.values()] == [
        Random(seed).getstate() for seed in (7, 8)
    ]
    one = desk.member()
    desk.send(one, pack(Kind.FAULTS, b"[]"))
    assert [bool(bus._faults) for bus in desk.server.buses.values()] == [False, True]


@pytest.mark.parametrize(
    ("event_ns", "crowded", "delivered_ns", "wakes_ns"),
    [
        (None, True, 0, None),
        (5_000_000, True, 3_000_000, 5_000_000),
        (3_500_000, True, 3_000_000, 4_000_000),  # in a burst every 2 ms
        (3_500_000, True, 4_000_000, 6_000_000),
        (3_500_000, True, 3_999_999, 4_000_000),
        (1_000_000, False, 1_000_000, 1_250_000),  # otherwise 0.25 ms after the last delivery
        (2_000_000, False, 1_000_000, 2_000_000),
    ],
)
def test_when_a_bus_is_looked_at_next(
    event_ns: int | None, crowded: bool, delivered_ns: int, wakes_ns: int | None
) -> None:
    bus = SimpleNamespace(next_event_ns=lambda: event_ns, crowded=crowded)
    line: Any = SimpleNamespace(bus=bus, delivered_ns=delivered_ns)
    assert BusServer._wake_ns(line) == wakes_ns


def test_sleep_ends_with_the_first_event_and_after_a_tenth_of_a_second(
    stack: ExitStack, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("bus.server.time", SimpleNamespace(monotonic_ns=lambda: 1_000_000_000))
    server = stack.enter_context(BusServer(["bus0", "bus1"], BusSettings(), tmp_path))
    assert server._sleep_s() == 0.1
    wakes: dict[str, int | None] = {"bus0": 1_050_000_000, "bus1": None}
    monkeypatch.setattr(server, "_wake_ns", lambda line: wakes[line.channel])
    assert server._sleep_s() == 0.05
    wakes["bus1"] = 1_020_000_000
    assert server._sleep_s() == 0.02
    wakes["bus1"] = 999_000_000
    assert server._sleep_s() == 0.0
    wakes.update(bus0=1_200_000_000, bus1=None)
    assert server._sleep_s() == 0.1
    virtual = stack.enter_context(BusServer(["bus2"], BusSettings(virtual_clock=True), tmp_path))
    assert virtual._sleep_s() == 0.1
    monkeypatch.setattr(virtual, "_wake_ns", lambda _: 1_200_000_000)
    assert virtual._sleep_s() == 0.0
