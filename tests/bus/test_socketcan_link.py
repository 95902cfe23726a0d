"""The SocketCAN link on sockets of a test's own: how it sets them up, what it does when they fail."""

import errno
import os
import socket
import struct
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bus import reconnecting, socketcan
from bus.intake import new_intake
from bus.interface import Timing, Wanted
from bus.link import State
from bus.socketcan import SocketCanLink
from bus.told import CAME, DEVICE_ERROR, NEEDS_LOOK, STAMP_ERROR
from canskin.errors import BusError, InputError
from dbc.frame import ECHO, ERROR, FD, frame_bytes
from tests.bus.harness import burst, frame, interface

# Numbers of the kernel, from its headers.
AF_CAN, SOCK_RAW, CAN_RAW, SOL_CAN_RAW = 29, 3, 1, 101
CAN_RAW_ERR_FILTER, CAN_RAW_RECV_OWN_MSGS, CAN_RAW_FD_FRAMES = 2, 4, 5
SO_RCVBUF, SO_RCVBUFFORCE, SO_TIMESTAMPNS, SO_TIMESTAMPING, SO_RXQ_OVFL = 8, 33, 35, 37, 40
SOF_TIMESTAMPING_RX_HARDWARE, SOF_TIMESTAMPING_RAW_HARDWARE = 1 << 2, 1 << 6


class Kernel:
    """Hands out one end of a pair of datagram sockets for each CAN socket, and notes what is set on it."""

    def __init__(self) -> None:
        self.options: dict[tuple[int, int], Any] = {}
        self.bound: list[Any] = []
        self.opened: list[tuple[int, ...]] = []
        self.refuses: OSError | None = None
        self.may_force = True
        self.far: list[socket.socket] = []

    def open(self, *kind: int) -> socket.socket:
        kernel = self

        class Noted(socket.socket):
            def setsockopt(self, level: int, name: int, value: Any) -> None:  # type: ignore[override]
                if name == SO_RCVBUFFORCE and not kernel.may_force:
                    raise PermissionError(errno.EPERM, "not permitted")
                kernel.options[level, name] = value

            def bind(self, address: Any) -> None:
                if kernel.refuses is not None:
                    raise kernel.refuses
                kernel.bound.append(address)

        self.opened.append(kind)
        near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.far.append(far)
        return Noted(fileno=near.detach())

    def put(self, can_id: int, data: bytes = b"") -> None:
        self.far[-1].send(struct.pack("=IB3x8s", can_id, len(data), data))


@pytest.fixture
def kernel(monkeypatch: pytest.MonkeyPatch) -> Iterator[Kernel]:
    made = Kernel()

    class Module:
        """The module `socket`, whose sockets are the test's."""

        def __getattr__(self, name: str) -> Any:
            return made.open if name == "socket" else getattr(socket, name)

    monkeypatch.setattr(socketcan, "socket", Module())
    yield made
    for far in made.far:
        far.close()


class Clock:
    """The module `time` of a link: time passes when the test says so."""

    now_s = 100.0

    def monotonic(self) -> float:
        return self.now_s

    def pass_wait(self) -> None:
        self.now_s += reconnecting.LONGEST_S


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    monkeypatch.setattr(reconnecting, "time", made)
    return made


@pytest.fixture
def link(kernel: Kernel) -> Iterator[SocketCanLink]:
    made = SocketCanLink("can7")
    yield made
    made.close()


def test_fd_is_asked_for(kernel: Kernel) -> None:
    kernel.may_force = False
    made = SocketCanLink("can7", Wanted(fd=True))
    assert kernel.options[SOL_CAN_RAW, CAN_RAW_FD_FRAMES] == 1
    assert made.send(frame(0x181, bytes(13), FD)) == 1
    sent = kernel.far[0].recv(100)
    assert (len(sent), sent[4]) == (72, 16)  # the next length that CAN FD has
    made.close()


def test_echoes_of_sync_have_the_times_of_the_device(link: SocketCanLink) -> None:
    """The kernel's stamps are 10 us late, those of some frames 3 ms more."""
    told, first_ns = new_intake(1).told[0], time.monotonic_ns()
    link.tell(told)
    late_ns = []
    for number in range(500):
        end_ns = first_ns + number * 10_000_000
        rows = np.concatenate([frame(0x80, flags=ECHO), frame(0x181)])
        rows["time_ns"] = end_ns + 10_000 + 3_000_000 * (number % 7 == 0)
        rows["expires_ns"][0] = 1_000 + number * 10_000_000
        told[CAME], told[NEEDS_LOOK], told[STAMP_ERROR] = 2, True, 5 + told[DEVICE_ERROR]
        sync, other = link.arrived(frame_bytes(rows))
        assert sync["expires_ns"] == 0
        late_ns.append((int(sync["time_ns"]) - end_ns, int(other["time_ns"]) - end_ns))
    by_device, by_kernel = np.array(late_ns)[-100:].T
    assert np.abs(by_device - 10_000).max() < 100
    assert np.ptp(by_kernel) > 2_900_000
    assert link.stamp_error_ns == 5 + told[DEVICE_ERROR]


def test_without_stamps_the_time_is_that_of_reading(kernel: Kernel, link: SocketCanLink) -> None:
    assert link.stamp_error_ns is not None
    kernel.put(0x80)
    assert len(link.receive()) == 1
    assert link.stamp_error_ns is None  # the test's sockets give none


def test_frames_go_out_and_come_in(kernel: Kernel, link: SocketCanLink) -> None:
    assert link.send(burst(range(5))) == 5
    assert [struct.unpack("=I", kernel.far[0].recv(100)[:4])[0] for _ in range(5)] == burst(range(5))["can_id"].tolist()
    before_ns = time.monotonic_ns()
    for number in range(3):
        kernel.put(0x100 + number, bytes((number,)))
    came = link.receive()
    assert came["can_id"].tolist() == [0x100, 0x101, 0x102]
    assert came["data"][:, 0].tolist() == [0, 1, 2]
    assert (came["time_ns"] >= before_ns).all()
    assert not came["flags"].any()
    assert link.dropped == 0
    with pytest.raises(InputError):
        link.send(frame(0x181, bytes(12), FD))


def test_all_that_waits_is_received_at_once(kernel: Kernel, link: SocketCanLink) -> None:
    kernel.far[0].setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 20)
    for number in range(600):
        kernel.put(number)
    assert link.receive()["can_id"].tolist() == list(range(600))


@pytest.mark.parametrize(("control", "expected"), [(0x10, State.PASSIVE), (0x40, State.ACTIVE), (0x08, State.WARNING)])
def test_reports_of_the_controller_tell_its_state(
    kernel: Kernel, link: SocketCanLink, control: int, expected: State
) -> None:
    assert link.state is State.ACTIVE
    kernel.put(0x20000004, bytes((0, control, 0, 0, 0, 0, 0, 0)))
    (report,) = link.receive()
    assert report["flags"] & (ERROR | ECHO) == ERROR
    assert link.state is expected
    kernel.put(0x20000040)
    link.receive()
    assert link.state is State.BUS_OFF


def test_lost_interface_is_opened_again_after_waits_that_double(
    kernel: Kernel, link: SocketCanLink, clock: Clock
) -> None:
    kernel.far[0].close()
    assert link.send(burst(range(3))) == 0
    assert link.state is State.LOST
    assert link.receive().size == 0
    kernel.refuses = OSError(errno.ENETDOWN, "down")
    waits_s = []
    for _ in range(5):
        since_s, tries = clock.now_s, len(kernel.opened)
        while len(kernel.opened) == tries:
            clock.now_s += 0.01
            assert link.send(burst(range(3))) == 0
        waits_s.append(clock.now_s - since_s)
    assert waits_s == pytest.approx([0.05, 0.1, 0.2, 0.2, 0.2], abs=0.02)
    kernel.refuses = None
    clock.pass_wait()
    assert link.send(burst(range(3))) == 3
    assert link.state is State.ACTIVE
    assert len(kernel.far[-1].recv(100)) == 16


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (errno.ENODEV, "cannot open can7: no such interface; 'ip link' lists them"),
        (errno.EAFNOSUPPORT, "cannot open can7: this system has no CAN sockets; load can_raw, or use"),
        (errno.EPROTONOSUPPORT, "cannot open can7: this system has no CAN sockets; load can_raw, or use"),
        (errno.EACCES, "cannot open can7: Permission denied"),
    ],
)
def test_socket_that_cannot_be_bound_is_closed_and_says_what_to_do(kernel: Kernel, number: int, words: str) -> None:
    kernel.refuses = OSError(number, os.strerror(number))
    with pytest.raises(BusError) as caught:
        SocketCanLink("can7")
    assert str(caught.value).startswith(words)
    with pytest.raises(ConnectionRefusedError):
        kernel.far[0].send(b"1")


def test_interface_that_cannot_work_is_refused_and_opened_when_it_can(
    kernel: Kernel, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [interface()]
    monkeypatch.setattr(socketcan, "read_interface", lambda _channel: now[0])
    now[0] = interface(timing=Timing(500_000, 0.875))
    with pytest.raises(BusError, match="its bit rate is 500000 bit/s"):
        SocketCanLink("can7", Wanted(1_000_000))
    assert not kernel.opened
    now[0] = interface(state=State.PASSIVE)
    link = SocketCanLink("can7", Wanted(1_000_000))
    assert link.state is State.PASSIVE  # no error frame has told
    kernel.far[0].close()
    assert link.send(burst(range(3))) == 0
    now[0] = interface(timing=Timing(500_000, 0.875))
    clock.pass_wait()
    assert link.send(burst(range(3))) == 0
    assert (link.state, link.explain()[:21]) == (State.LOST, "cannot open can7: its")
    now[0] = interface()
    clock.pass_wait()
    assert link.send(burst(range(3))) == 3
    assert (link.state, link.explain()) == (State.ACTIVE, "")
    link.close()


def test_settings_and_doubts_are_told_once(
    kernel: Kernel, clock: Clock, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(socketcan, "read_interface", lambda _channel: interface(restart_ms=0))
    link = SocketCanLink("can7", name="gateway")
    kernel.far[0].close()
    link.send(burst(range(3)))
    clock.pass_wait()
    assert link.send(burst(range(3))) == 3
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("gateway: can7: its restart-ms is 0")
    link.close()


@pytest.mark.parametrize(
    ("state", "about", "words"),
    [
        (State.PASSIVE, {"errors": (128, 3)}, "transmit errors 128, receive errors 3"),
        (State.BUS_OFF, {"errors": (248, 0)}, "transmit errors 248, receive errors 0; it restarts after 100 ms"),
        (State.BUS_OFF, {"restart_ms": 0}, "'ip link set can7 type can restart' starts it"),
        (State.BUS_OFF, {"restart_ms": None}, "plug the adapter in again"),
        (State.ACTIVE, {}, ""),
    ],
)
def test_state_is_that_of_the_kernel_though_no_error_frame_comes(
    link: SocketCanLink, monkeypatch: pytest.MonkeyPatch, state: State, about: dict[str, Any], words: str
) -> None:
    monkeypatch.setattr(socketcan, "read_interface", lambda _channel: interface(state=state, **about))
    assert link.explain() == words
    assert link.state is state


def test_full_queue_takes_what_fits_and_is_told_apart_from_a_frame_that_comes_too_late(link: SocketCanLink) -> None:
    late = frame(0x80)
    late["expires_ns"] = time.monotonic_ns() - 1
    assert link.send(late) == 0
    assert link.explain() == ""
    many = np.concatenate([burst(range(100))] * 50)
    taken = link.send(many)
    assert 0 < taken < len(many)
    assert link.send(many[taken:]) == 0
    assert link.explain().startswith("its transmit queue is full")
    assert link.explain() == ""


@pytest.mark.parametrize(
    ("bus", "driver", "is_proven"),
    [
        ("platform", "m_can", True),
        ("spi", "mcp251xfd", True),
        ("usb", "kvaser_usb", True),
        ("usb", "peak_usb", False),
        ("usb", "gs_usb", False),
        ("usb", "made tomorrow", False),
        ("spi", "mcp251x", False),
        (None, None, True),
    ],
)
def test_the_echo_is_trusted_where_the_driver_gives_it_after_the_bus_and_before_the_answers(
    kernel: Kernel,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    bus: str | None,
    driver: str | None,
    is_proven: bool,
) -> None:
    about = tmp_path / "can7"
    about.mkdir()
    if bus is not None and driver is not None:
        device = tmp_path / "device"
        for place, name in (("subsystem", bus), ("driver", driver)):
            (tmp_path / place / name).mkdir(parents=True)
            device.mkdir(exist_ok=True)
            (device / place).symlink_to(tmp_path / place / name)
        (about / "device").symlink_to(device)
    monkeypatch.setattr(socketcan, "Path", lambda _folder, *names: tmp_path.joinpath(*names))
    monkeypatch.setattr(socketcan, "read_interface", lambda _channel: interface())
    link = SocketCanLink("can7")
    assert link.proves_echo is is_proven
    link.close()
