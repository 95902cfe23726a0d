"""The SocketCAN link on a kernel that has CAN: needs an interface vcan0 that is up, with an MTU of 72."""

import subprocess
from collections.abc import Iterator
from pathlib import Path

import can
import numpy as np
import pytest

from bus.error_frames import State
from bus.link import Link, open_link
from dbc.frame import BRS, ECHO, ERROR, EXTENDED, FD, REMOTE
from tests.bus.harness import await_state, burst, collect, frame

pytestmark = pytest.mark.skipif(
    not Path("/sys/class/net/vcan0").exists(),
    reason="NOT TESTED: SocketCAN, for want of vcan0 ('ip link add vcan0 type vcan; ip link set vcan0 mtu 72 up')",
)


def ip_link(*arguments: str) -> None:
    done = subprocess.run(["ip", "link", *arguments], capture_output=True, check=False)
    if done.returncode:
        pytest.skip(f"NOT TESTED: 'ip link' is not allowed: {done.stderr.decode().strip()}")


@pytest.fixture
def links() -> Iterator[list[Link]]:
    opened = [open_link("socketcan", "vcan0", 1_000_000, fd=True) for _ in range(2)]
    yield opened
    for link in opened:
        link.close()


def test_frames_of_every_kind_arrive_in_order_and_are_echoed(links: list[Link]) -> None:
    one, two = links
    special = [
        frame(0x1ABCDEF, bytes(3), EXTENDED),
        frame(0x701, flags=REMOTE),
        frame(0x181, bytes(range(64)), FD | BRS),
        frame(0x182, bytes(40), FD),
    ]
    sent = np.concatenate([burst(range(300)), *special])
    assert one.send(sent) == len(sent)
    arrived, echoes = collect(two, len(sent)), collect(one, len(sent))
    assert (np.diff(arrived["time_ns"]) >= 0).all()
    assert (echoes["flags"] & ECHO != 0).all()
    arrived["time_ns"] = 0
    sent["length"][-1] = 48
    assert arrived.tobytes() == sent.tobytes()


def test_what_the_kernel_drops_is_counted(links: list[Link]) -> None:
    one, two = links
    sent = 0
    for _ in range(400):
        sent += one.send(burst(range(256)))
        one.receive()
    sent += one.send(frame(0x7FF))
    read = 0
    while size := len(two.receive()):
        read += size
    one.send(frame(0x7FE))  # the next frame carries the count
    collect(two, 1)
    assert two.dropped > 0
    assert read + two.dropped == sent


def test_error_frames_tell_the_state(links: list[Link]) -> None:
    with can.Bus(interface="socketcan", channel="vcan0") as other:
        passive = [0, 0x20, 0, 0, 0, 0, 130, 0]
        other.send(can.Message(arbitration_id=0x204, is_error_frame=True, is_extended_id=False, data=passive))
        assert collect(links[0], 1)["flags"].tolist() == [ERROR]
    assert links[0].state is State.PASSIVE


def test_an_interface_that_goes_down_or_away_is_opened_again(links: list[Link]) -> None:
    for gone, back in (
        (("set", "vcan0", "down"), [("set", "vcan0", "up")]),
        (("del", "vcan0"), [("add", "vcan0", "type", "vcan"), ("set", "vcan0", "mtu", "72", "up")]),
    ):
        ip_link(*gone)
        for link in links:
            await_state(link, State.LOST)
            assert link.send(frame(1)) == 0
        for step in back:
            ip_link(*step)
        for link in links:
            await_state(link, State.ACTIVE)
        links[0].send(frame(0x33))
        assert collect(links[1], 1)["can_id"].tolist() == [0x33]
