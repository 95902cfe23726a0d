"""What ``skin bus`` makes of its options, without a process."""

from collections.abc import Callable
from typing import Any, Self

import pytest

from bus import command
from bus.faults import Fault
from bus.server import BusSettings
from bus.simulated_bus import SimulatedBus
from canskin.errors import InputError


class Server:
    """A server that serves nothing and keeps what it was given."""

    made: "list[Server]"

    def __init__(self, channels: list[str], settings: BusSettings) -> None:
        self.channels, self.settings = channels, settings
        self.buses = {name: SimulatedBus() for name in channels}
        self.served = 0
        self.made.append(self)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None: ...

    def serve(self, stopped: Callable[[], bool]) -> None:
        assert not stopped()
        self.served += 1


@pytest.fixture
def said(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Keep what the command says, prints and asks for."""
    kept: list[Any] = []
    Server.made = []
    monkeypatch.setattr(command, "BusServer", Server)
    monkeypatch.setattr(command, "say", lambda *words: kept.append(words))
    monkeypatch.setattr(command, "print_json", kept.append)
    monkeypatch.setattr(command, "request_real_time", lambda: kept.append("real time"))
    monkeypatch.setattr(command.StopSignal, "install", lambda self: self)
    return kept


def test_without_options_four_buses_have_both_rates_of_a_fast_skin(said: list[Any]) -> None:
    command.bus()
    (server,) = Server.made
    assert server.channels == ["bus0", "bus1", "bus2", "bus3"]
    assert server.settings == BusSettings(
        bitrate=1_000_000,
        data_bitrate=5_000_000,
        virtual_clock=False,
        faults=[],
        seed=0,
        restart_s=0.1,
        queue_size=256,
    )
    assert server.settings == BusSettings(faults=[])
    assert server.served == 1
    assert said == ["real time", ("bus", "ready: bus0, bus1, bus2, bus3 at 1000000 bit/s")]


def test_every_option_reaches_the_buses(said: list[Any]) -> None:
    command.bus(
        ["left"], bitrate=250_000, data_bitrate=0, clock="virtual", fault=["loss_ratio=0.5", "can_id=0x80,mask=1,off"],
        seed=7, restart_s=2.0, queue_size=3, json_=True,
    )  # fmt: skip
    (server,) = Server.made
    assert server.channels == ["left"]
    assert server.settings == BusSettings(
        bitrate=250_000,
        data_bitrate=None,
        virtual_clock=True,
        faults=[Fault(loss_ratio=0.5), Fault(can_id=0x80, mask=1, off=True)],
        seed=7,
        restart_s=2.0,
        queue_size=3,
    )
    assert said[1:] == [("bus", "ready: left at 250000 bit/s"), {"left": server.buses["left"].counts}]


@pytest.mark.parametrize(
    "limits",
    [
        {"bitrate": 10_000, "data_bitrate": 10_000},
        {"bitrate": 1_000_000, "data_bitrate": 1_000_000},
        {"data_bitrate": 8_000_000},
        {"queue_size": 1, "restart_s": 0.0},
        {"restart_s": 3600.0},
    ],
)
def test_limits_are_allowed(said: list[Any], limits: dict[str, Any]) -> None:
    command.bus(**limits)
    assert Server.made[0].served == 1
    assert len(said) == 2


@pytest.mark.parametrize(
    "beyond",
    [
        {"bitrate": 9_999},
        {"bitrate": 1_000_001},
        {"bitrate": 500_000, "data_bitrate": 499_999},
        {"data_bitrate": 8_000_001},
        {"data_bitrate": -1},
        {"queue_size": 0},
        {"restart_s": -0.001},
        {"restart_s": 3600.001},
        {"queue_size": 0, "restart_s": 5.0},
    ],
)
def test_what_is_beyond_is_refused(said: list[Any], beyond: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="expected"):
        command.bus(**beyond)
    assert (Server.made, said) == ([], [])
