"""``skin bus`` as a person uses it."""

import json
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from bus.arbitrated import ArbitratedLink
from bus.command import bus
from bus.protocol import Hello, Welcome
from bus.server import BusServer, BusSettings
from canskin.errors import BusError, InputError
from tests.bus.harness import burst, collect
from tests.layouts import buses, layout_toml
from tests.processes import PATIENCE_S


def start(*arguments: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "skin", "bus", *arguments]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


@pytest.mark.heavy
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_it_says_that_it_is_ready_carries_frames_and_ends_quietly(how: int) -> None:
    rates = "--bitrate", "500000", "--data-bitrate", "0", "--queue-size", "10"
    process = start("left", "right", *rates, "--fault", "controller=a:*,loss_ratio=1", "--json")
    try:
        assert process.stderr is not None
        assert process.stderr.readline().startswith("bus: scheduling: ")
        assert process.stderr.readline() == "bus: ready: left, right at 500000 bit/s\n"
        a, b = (ArbitratedLink("right", Hello(name=name, bitrate=500_000)) for name in "ab")
        assert a.welcome == Welcome(bitrate=500_000, data_bitrate=None, queue_size=10)
        a.send(burst(range(10)))
        collect(a, 10)
        a.close()
        b.close()
        process.send_signal(how)
        out, said = process.communicate(timeout=PATIENCE_S)
    finally:
        process.kill()
        process.communicate()
    assert (process.returncode, said) == (0, "")
    counts = json.loads(out)
    assert counts["left"]["accepted"] == 0
    assert (counts["right"]["transmitted"], counts["right"]["lost"]) == (10, 10)


@pytest.mark.heavy
def test_wrong_input_is_one_line_and_status_2() -> None:
    process = start("--data-bitrate", "1000")
    out, said = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, out, said.count("\n")) == (2, "", 1)
    assert "1000000 (the bit rate) to 8000000 bit/s, or 0 for no CAN FD" in said


def test_the_buses_of_a_layout_have_its_names_and_bit_rates(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[tuple[list[str], int, int | None]] = []

    def served(names: list[str], settings: BusSettings) -> BusServer:
        opened.append((names, settings.bitrate, settings.data_bitrate))
        raise BusError("seen")

    monkeypatch.setattr("bus.command.BusServer", served)
    rates = {"bitrate": 500_000, "fd": True, "data_bitrate": 2_000_000}
    (tmp_path / "palm.toml").write_text(layout_toml(bus=buses(1, 1, names=["left", "right"], **rates)))
    for options in ({"layout": tmp_path / "palm.toml"}, {"layout": tmp_path / "palm.toml", "bitrate": 250_000}, {}):
        with pytest.raises(BusError, match="seen"):
            bus(**options)  # type: ignore[arg-type]
    assert opened == [
        (["left", "right"], 500_000, 2_000_000),
        (["left", "right"], 250_000, 2_000_000),
        (["bus0", "bus1", "bus2", "bus3"], 1_000_000, 5_000_000),
    ]


@pytest.mark.parametrize(
    ("options", "what"),
    [
        ({"bitrate": 9_999}, "bit rate of 10000 to 1000000 bit/s"),
        ({"bitrate": 1_000_001}, "bit rate of 10000 to 1000000 bit/s"),
        ({"bitrate": 500_000, "data_bitrate": 499_999}, "a data bit rate of 500000"),
        ({"data_bitrate": 8_000_001}, "to 8000000 bit/s, or 0"),
        ({"data_bitrate": -1}, "to 8000000 bit/s, or 0"),
        ({"queue_size": 0}, "a queue of 1 or more frames"),
        ({"restart_s": -0.001}, "restart after 0 to 3600 s"),
        ({"restart_s": 3600.001}, "restart after 0 to 3600 s"),
        ({"restart_s": float("nan")}, "restart after 0 to 3600 s"),
        ({"fault": ["lost=1"]}, "loss_ratio"),
        ({"channels": ["a/b"]}, "cannot name a bus"),
    ],
)
def test_options_that_no_bus_can_have_are_refused(options: dict[str, Any], what: str) -> None:
    with pytest.raises(InputError) as refused:
        bus(**options)
    assert what in str(refused.value)
