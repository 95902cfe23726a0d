"""Channels of the command line, and which bus each belongs to."""

from dataclasses import dataclass
from typing import Any

import pytest
from cyclopts import App, CycloptsError

from bus import options
from bus.interface import Controller, Interface, Mode, Timing
from bus.options import OPEN_WAIT_S, BusOptions, channels, open_channels, open_links
from canskin.errors import InputError
from skin.layout import Layout
from tests.layouts import buses, small_layout


def layout_of(*names: str) -> Layout:
    return small_layout(8, 16 * len(names), bus=buses(*[4] * len(names), names=names))


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ([], ["left", "right"]),
        (["can0"], ["can0", "can1"]),
        (["vcan12"], ["vcan12", "vcan13"]),
        (["can9"], ["can9", "can10"]),
        (["a1b2"], ["a1b2", "a1b3"]),
        (["can3", "can1"], ["can3", "can1"]),
        (["can3,can1"], ["can3", "can1"]),
    ],
)
def test_every_bus_has_a_channel(given: list[str], expected: list[str]) -> None:
    assert channels(layout_of("left", "right"), BusOptions(channel=given)) == expected


def test_the_channel_of_a_single_bus_is_taken_as_it_is() -> None:
    assert channels(layout_of("only"), BusOptions(channel=["can7"])) == ["can7"]
    assert channels(layout_of("only"), BusOptions()) == ["only"]


@pytest.mark.parametrize("given", [["can"], ["can0", "can1", "can2"]])
def test_another_number_of_channels_is_refused(given: list[str]) -> None:
    with pytest.raises(InputError, match=rf"expected 2 channels.*got {len(given)}"):
        channels(layout_of("left", "right"), BusOptions(channel=given))


@pytest.mark.parametrize(
    ("interface", "given", "says"),
    [
        ("socketcan", ["can/0"], "without space"),
        ("socketcan", ["can 0"], "got 'can 0'"),
        ("socketcan", ["can0; rm -rf x"], "without space"),
        ("socketcan", ["..", "can1"], "got '..'"),
        ("socketcan", ["c" * 16, "can0"], "1 to 15 bytes"),
        ("socketcan", ["c" * 15 + "0"], "1 to 15 bytes"),
        ("canskin", ["", "can0"], "empty name"),
        ("slcan", ["/dev/ttyACM0", "/dev/ttyACM0"], "each channel once, got /dev/ttyACM0 for 2 buses"),
    ],
)
def test_a_channel_that_cannot_be_is_refused(interface: str, given: list[str], says: str) -> None:
    layout = layout_of(*("left", "right")[: len(given)])
    with pytest.raises(InputError, match=says):
        channels(layout, BusOptions(interface, given))
    with pytest.raises(InputError, match=says):
        open_channels(BusOptions(interface, given), 500_000, None, name="scan")


def test_names_of_adapters_that_are_no_network_interfaces_are_free() -> None:
    given = ["/dev/serial/by-id/usb-Some_maker-if00", "socket://localhost:5000"]
    assert channels(layout_of("left", "right"), BusOptions("slcan", given)) == given


def test_a_flag_without_a_channel_is_refused() -> None:
    app = App(result_action="return_value", exit_on_error=False, print_error=False)

    @app.default
    def verb(can: BusOptions | None = None) -> BusOptions | None:
        return can

    assert app(["-i", "socketcan", "-c", "can0"]) == BusOptions("socketcan", ["can0"])
    with pytest.raises(CycloptsError):
        app(["-i", "socketcan", "-c"])


@dataclass
class Opened:
    """A link that tells how it was opened."""

    interface: str
    channel: str
    bitrate: int
    rest: dict[str, Any]


def test_wanted_buses_are_opened_on_their_channels_and_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(options, "open_link", lambda *place, **rest: Opened(*place, rest))
    layout = layout_of("left", "right")
    every: dict[int, Any] = open_links(layout, BusOptions("socketcan", ["can4"]), name="gateway")
    assert {number: (link.interface, link.channel) for number, link in every.items()} == {
        0: ("socketcan", "can4"),
        1: ("socketcan", "can5"),
    }
    assert every[0].bitrate == layout.bus[0].bitrate
    expected = {
        "fd": False,
        "data_bitrate": layout.bus[0].data_bitrate,
        "name": "gateway",
        "sends": True,
        "wait_s": OPEN_WAIT_S,
        "stop": None,
        "options": {},
    }
    assert every[0].rest == expected
    some: dict[int, Any] = open_links(layout, BusOptions(), {1})
    assert {number: (link.interface, link.channel) for number, link in some.items()} == {1: ("canskin", "right")}


def test_options_of_the_interface_have_the_types_of_python_can(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(options, "open_link", lambda *place, **rest: Opened(*place, rest))
    given = ["auto_reset=true", "tty_baudrate=1000000", "timeout=0.5", "device=/dev/a=b"]
    links: dict[int, Any] = open_links(layout_of("only"), BusOptions("slcan", ["x"], given))
    typed = {"auto_reset": True, "tty_baudrate": 1_000_000, "timeout": 0.5, "device": "/dev/a=b"}
    assert links[0].rest["options"] == typed
    with pytest.raises(InputError, match="NAME=VALUE, got 'auto_reset'"):
        open_links(layout_of("only"), BusOptions("slcan", ["x"], ["auto_reset"]))


@pytest.mark.parametrize(
    ("interface", "data_bitrate", "is_fd"),
    [("socketcan", None, True), ("pcan", None, False), ("pcan", 5_000_000, True), ("canskin", 5_000_000, True)],
)
def test_channels_without_a_layout_are_can_fd_where_the_interface_is(
    interface: str, data_bitrate: int | None, is_fd: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(options, "open_link", lambda *place, **rest: Opened(*place, rest))
    # The loopback's MTU is larger than a frame of CAN FD.
    links: dict[str, Any] = open_channels(BusOptions(interface, ["lo"], ["a=1"]), 500_000, data_bitrate, name="scan")
    assert links["lo"].rest["fd"] == is_fd
    assert links["lo"].bitrate == 500_000


def test_an_interface_of_socketcan_is_opened_with_its_own_rates(monkeypatch: pytest.MonkeyPatch) -> None:
    device = Controller(Timing(250_000, 0.875), Timing(2_000_000, 0.75), None, Mode(0), None, None)
    about = Interface("can", True, True, 72, 10, device)
    monkeypatch.setattr("bus.interface.read_interface", lambda _channel: about)
    monkeypatch.setattr(options, "open_link", lambda *place, **rest: Opened(*place, rest))
    links: dict[str, Any] = open_channels(BusOptions("socketcan", ["can0"]), 1_000_000, None, name="scan", sends=False)
    link = links["can0"]
    assert (link.bitrate, link.rest["data_bitrate"], link.rest["fd"]) == (250_000, 2_000_000, True)
    assert link.rest["sends"] is False
