"""What the kernel says of an interface, in bytes as it writes them; differences, and the command that mends them."""

import struct
from dataclasses import replace
from typing import Any

import pytest

from bus.error_frames import State
from bus.interface import (
    Controller,
    Interface,
    Mode,
    Timing,
    Wanted,
    check_interface,
    describe_interface,
    parse_interface,
    read_interface,
)
from canskin.errors import BusError
from tests.bus.harness import interface

# Numbers of if_link.h, rtnetlink.h and can/netlink.h.
RTM_NEWLINK, NLMSG_ERROR, ARPHRD_CAN, IFF_UP, IFF_ECHO = 16, 2, 280, 0x1, 0x40000
IFNAME, MTU, QDISC, TXQLEN, LINKINFO, KIND, DATA = 3, 4, 6, 13, 18, 1, 2
BITTIMING, BITTIMING_CONST, CLOCK, STATE, CTRLMODE, RESTART_MS, BERR_COUNTER, DATA_BITTIMING = 1, 2, 3, 4, 5, 6, 8, 9
NESTED = 0x8000


def attribute(kind: int, data: bytes) -> bytes:
    return struct.pack("=HH", 4 + len(data), kind) + data.ljust(-(-len(data) // 4) * 4, b"\0")


def bittiming(bit_rate_hz: int, sample_point: int) -> bytes:
    return struct.pack("=8I", bit_rate_hz, sample_point, 25, 14, 15, 10, 1, 1)


def answer(flags: int, *attributes: bytes) -> bytes:
    body = struct.pack("=BxHiII", 0, ARPHRD_CAN, 7, flags, 0) + b"".join(attributes)
    return struct.pack("=IHHII", 16 + len(body), RTM_NEWLINK, 0, 1, 4711) + body


def of_can(*about: bytes, mtu: int = 16) -> bytes:
    info = attribute(KIND, b"can\0") + attribute(DATA | NESTED, b"".join(about))
    parts = [(IFNAME, b"can0\0"), (TXQLEN, struct.pack("=I", 10)), (MTU, struct.pack("=I", mtu))]
    link = [attribute(kind, data) for kind, data in parts]
    return answer(IFF_UP | IFF_ECHO, *link, attribute(QDISC, b"pfifo_fast\0"), attribute(LINKINFO, info))


def test_controller_is_read_as_the_kernel_writes_it() -> None:
    told = of_can(
        attribute(BITTIMING, bittiming(500_000, 875)),
        attribute(BITTIMING_CONST, b"mcp251xfd".ljust(48, b"\0")),
        attribute(CLOCK, struct.pack("=I", 40_000_000)),
        attribute(STATE, struct.pack("=I", 2)),
        attribute(CTRLMODE, struct.pack("=II", 0, 0x20 | 0x02)),
        attribute(RESTART_MS, struct.pack("=I", 100)),
        attribute(BERR_COUNTER, struct.pack("=HH", 128, 7)),
        attribute(DATA_BITTIMING, bittiming(4_000_000, 800)),
        mtu=72,
    )
    device = Controller(
        Timing(500_000, 0.875), Timing(4_000_000, 0.8), State.PASSIVE, Mode.LISTEN_ONLY | Mode(0x20), 100, (128, 7)
    )
    assert parse_interface(told) == Interface("can", True, True, 72, 10, device)


def test_what_a_driver_does_not_tell_is_unknown() -> None:
    told = of_can(attribute(STATE, struct.pack("=I", 4)), attribute(RESTART_MS, struct.pack("=I", 0)))
    device = Controller(None, None, None, Mode(0), None, None)
    assert parse_interface(told) == Interface("can", True, True, 16, 10, device)
    vcan = answer(
        0,
        attribute(MTU, struct.pack("=I", 72)),
        attribute(TXQLEN, struct.pack("=I", 1000)),
        attribute(QDISC, b"noqueue\0"),
        attribute(LINKINFO, attribute(KIND, b"vcan\0")),
    )
    assert parse_interface(vcan) == Interface("vcan", False, False, 72, None, None)


@pytest.mark.parametrize("cut", [1, 2, 3, 4, 17, 40])
def test_answer_that_is_cut_is_not_read_past_its_end(cut: int) -> None:
    told = of_can(attribute(BITTIMING, bittiming(500_000, 875)), attribute(STATE, struct.pack("=I", 0)))
    parse_interface(told[:-cut])


def test_error_of_the_kernel_is_raised() -> None:
    with pytest.raises(OSError, match="No such device"):
        parse_interface(struct.pack("=IHHIIi", 36, NLMSG_ERROR, 0, 1, 4711, -19) + bytes(16))
    with pytest.raises(OSError):
        read_interface("nocan9")


def test_this_machine_answers() -> None:
    assert read_interface("lo").mtu > 0


CLASSIC, FD = Wanted(1_000_000), Wanted(1_000_000, 4_000_000, fd=True)
ON = {"mtu": 72, "data_timing": Timing(4_000_000, 0.8)}


@pytest.mark.parametrize(
    ("wanted", "about", "text", "command"),
    [
        (
            CLASSIC,
            {"timing": Timing(500_000, 0.875)},
            "its bit rate is 500000 bit/s, sample point 0.875, the layout has 1000000 bit/s",
            "ip link set can0 down && ip link set can0 up type can bitrate 1000000 sample-point 0.750",
        ),
        (
            FD,
            ON | {"data_timing": Timing(2_000_000, 0.8), "restart_ms": 0, "queue_frames": 5},
            "its data bit rate is 2000000 bit/s, sample point 0.800, the layout has 4000000 bit/s",
            (
                "ip link set can0 down && ip link set can0 txqueuelen 1000 up"
                " type can bitrate 1000000 sample-point 0.750 dbitrate 4000000 dsample-point 0.750 fd on restart-ms 100"
            ),
        ),
        (
            FD,
            {},
            "it carries no CAN FD",
            (
                "ip link set can0 down && ip link set can0 up type can"
                " bitrate 1000000 sample-point 0.750 dbitrate 4000000 dsample-point 0.750 fd on"
            ),
        ),
        (
            FD,
            {"controller": None},
            "it carries no CAN FD",
            "ip link set can0 down && ip link set can0 mtu 72 up",
        ),
        (CLASSIC, {"is_up": False}, "it is down", "ip link set can0 up"),
        (
            CLASSIC,
            {"is_up": False, "timing": None, "restart_ms": 0},
            "it is down",
            "ip link set can0 up type can bitrate 1000000 sample-point 0.750 restart-ms 100",
        ),
        (
            CLASSIC,
            {"modes": Mode.LISTEN_ONLY},
            "it is listen-only: it neither sends nor acknowledges frames",
            "ip link set can0 down && ip link set can0 up type can listen-only off",
        ),
    ],
)
def test_interface_that_cannot_work_is_refused_with_the_command(
    wanted: Wanted, about: dict[str, Any], text: str, command: str
) -> None:
    with pytest.raises(BusError) as caught:
        check_interface("can0", interface(**about), wanted)
    said = str(caught.value)
    assert said.startswith(f"cannot open can0: {text}")
    assert said.endswith(f": '{command}'")


@pytest.mark.parametrize(
    ("about", "text", "command"),
    [
        (
            {"restart_ms": 0},
            "its restart-ms is 0: after bus-off it stays off the bus",
            "ip link set can0 down && ip link set can0 up type can restart-ms 100",
        ),
        (
            {"timing": Timing(1_000_000, 0.6)},
            "its bit rate is 1000000 bit/s, sample point 0.600, CiA recommends 0.750",
            "ip link set can0 down && ip link set can0 up type can bitrate 1000000 sample-point 0.750",
        ),
        (
            {"queue_frames": 5},
            "its transmit queue has room for 5 frames, expected 10",
            "ip link set can0 txqueuelen 1000",
        ),
        (
            {"modes": Mode.ONE_SHOT | Mode.LOOPBACK},
            "it is in loopback: its frames may not reach the bus; it is one-shot",
            "ip link set can0 down && ip link set can0 up type can loopback off one-shot off",
        ),
        (
            ON | {"modes": Mode.FD_NON_ISO},
            "it is fd-non-iso",
            "ip link set can0 down && ip link set can0 up type can fd-non-iso off",
        ),
    ],
)
def test_doubtful_interface_is_told_with_the_command(about: dict[str, Any], text: str, command: str) -> None:
    said = check_interface("can0", interface(**about), FD if "mtu" in about else CLASSIC)
    assert said.startswith(f"can0: {text}")
    assert said.endswith(f": '{command}'")


@pytest.mark.parametrize(
    ("wanted", "about"),
    [
        (CLASSIC, {}),
        (FD, ON),
        (CLASSIC, ON | {"modes": Mode.FD_NON_ISO}),
        (CLASSIC, {"controller": None, "queue_frames": None}),
        (CLASSIC, {"timing": None, "restart_ms": None}),
        (Wanted(), {"timing": Timing(125_000, 0.875)}),
        (replace(CLASSIC, sends=False), {"modes": Mode.LISTEN_ONLY, "restart_ms": 0, "queue_frames": 1}),
    ],
)
def test_interface_that_works_says_nothing(wanted: Wanted, about: dict[str, Any]) -> None:
    assert check_interface("can0", interface(**about), wanted) == ""


def test_settings_and_state_are_one_line() -> None:
    assert describe_interface("can0", interface(**ON, errors=(3, 0))) == (
        "can0: 1000000 bit/s, sample point 0.750, data 4000000 bit/s, sample point 0.800, restart-ms 100,"
        " queue of 10 frames, error-active, transmit errors 3, receive errors 0"
    )
    unknown = interface(timing=None, restart_ms=None, state=None)
    assert describe_interface("can0", unknown) == (
        "can0: bit rate unknown, no restart after bus-off, queue of 10 frames, stopped"
    )
    assert describe_interface("vcan0", interface(controller=None)) == ""
