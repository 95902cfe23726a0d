"""Faults of the gateway's links on a real kernel: told once on log and page; the skin is whole again by itself.

bus0 of the gateway is an slcan adapter in front of vcan0, bus1 is vcan1.
"""

import re
import socket
import struct
import subprocess
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import pytest

from bus.link import open_link
from canskin.errors import BusError
from health.state import ViewState
from tests.layouts import buses, layout_toml
from tests.vcan.chain import RATE_HZ, Chain, complete, ip_link, running_chain
from tests.vcan.slcan import Adapter

NAME = "slcan0"
SETTINGS = ("txqueuelen", "10", "up", "type", "can", "bitrate", "1000000")
#: Error frames of include/uapi/linux/can/error.h, with CAN_ERR_FLAG.
BUS_OFF, RESTARTED = 0x20000040, 0x20000100
#: In cycles: how long each fault lasts.
LASTS = 8


@dataclass
class Bench:
    chain: Chain
    adapter: Adapter


@pytest.fixture(scope="module")
def adapter() -> Iterator[Adapter]:
    made = Adapter(NAME, "vcan0")
    made.plug(*SETTINGS)
    yield made
    made.unplug()


@pytest.fixture(scope="module")
def bench(adapter: Adapter, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    folder = tmp_path_factory.mktemp("faults")
    path = folder / "faults.toml"
    path.write_text(layout_toml(8, 16, name="faults", sync={"rate_hz": float(RATE_HZ)}, bus=buses(2, 2)))
    with running_chain(folder, path=path, gateway=(NAME, "vcan1")) as chain:
        yield Bench(chain, adapter)


def replug(adapter: Adapter) -> None:
    adapter.plug(*SETTINGS)


def wrong_bit_rate(adapter: Adapter) -> None:
    adapter.unplug()
    adapter.plug(*SETTINGS[:-1], "500000")


def mend_bit_rate(_adapter: Adapter) -> None:
    ip_link("set", NAME, "down")
    ip_link("set", NAME, *SETTINGS)


def rename(_adapter: Adapter) -> None:
    ip_link("set", NAME, "down")
    ip_link("set", NAME, "name", "other0", "up")


def rename_back(_adapter: Adapter) -> None:
    ip_link("set", "other0", "down")
    ip_link("set", "other0", "name", NAME, "up")


def read_on(adapter: Adapter) -> None:
    adapter.reads = True


def report(can_id: int) -> Callable[[Adapter], None]:
    def put(_adapter: Adapter) -> None:
        with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as other:
            other.bind(("vcan1",))
            other.send(struct.pack("=IB3x8s", can_id, 8, bytes(8)))

    return put


LOST = "dead: the gateway has lost its interface: cannot open slcan0"
OFF = "dead: the gateway's controller is bus-off: wiring, termination or bit rate"
#: Bus, what breaks it, what mends it, and what is told.
FAULTS: dict[str, tuple[int, Callable[[Adapter], None], Callable[[Adapter], None], str]] = {
    "down": (0, lambda _: ip_link("set", NAME, "down"), lambda _: ip_link("set", NAME, "up"), f"{LOST}: it is down"),
    "renamed": (0, rename, rename_back, f"{LOST}: no such interface"),
    "unplugged": (0, Adapter.unplug, replug, f"{LOST}: no such interface"),
    "bit rate": (0, wrong_bit_rate, mend_bit_rate, f"{LOST}: its bit rate is 500000 bit/s, the layout has 1000000"),
    "queue full": (0, Adapter.fill, read_on, "without SYNC: its transmit queue is full"),
    "error-passive": (
        0,
        lambda adapter: adapter.tell_state("p", 0, 128),
        lambda adapter: adapter.tell_state("a"),
        "troubled: the gateway's controller is error passive",
    ),
    "bus-off, restarted": (1, report(BUS_OFF), report(RESTARTED), OFF),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_fault_is_told_once_and_the_skin_is_whole_again(bench: Bench, fault: str) -> None:
    bus, begin, mend, words = FAULTS[fault]
    chain = bench.chain
    chain.await_complete()
    log, first_status = chain.processes.log("gateway"), len(chain.statuses)
    first = len(log.read_text())
    begin(bench.adapter)
    chain.processes.until(lambda: words in log.read_text()[first:], f"'{words}'")
    chain.await_cycles(LASTS)
    mend(bench.adapter)
    mended_s, before = time.monotonic(), len(chain.measurements)
    chain.processes.until(lambda: any(map(complete, chain.measurements[before:])), "a complete measurement")
    print(f"{fault}: whole again after {time.monotonic() - mended_s:.1f} s")
    chain.processes.until(lambda: f"bus{bus} works again" in log.read_text()[first:], "the end of the fault")
    told = [line for line in log.read_text()[first:].splitlines() if line.startswith(f"gateway: bus{bus} ")]
    # While somebody mends a lost interface, it may have other reasons.
    assert [sum(words in line for line in told), "works again" in told[-1], len(set(told))] == [1, True, len(told)]
    chain.processes.until(lambda: not chain.statuses[-1].buses[bus].trouble, "a status without trouble")
    page = ViewState(chain.layout)
    shown = []
    for number, status in enumerate(chain.statuses[first_status:]):
        page.take(status, float(number))
        shown.append([each.text for each in page.snapshot(float(number))[0].notices if f"bus{bus} " in each.text])
    assert max(map(len, shown)) == 1
    assert any(words in each[0] for each in shown if each)


def test_bus_off_of_an_adapter_that_does_not_restart_says_what_helps(bench: Bench) -> None:
    chain, log = bench.chain, bench.chain.processes.log("gateway")
    first = len(log.read_text())
    bench.adapter.tell_state("b", 0, 255)
    chain.processes.until(lambda: f"bus0 {OFF}: plug the adapter in again" in log.read_text()[first:], "bus-off")
    bench.adapter.unplug()
    bench.adapter.plug(*SETTINGS)
    chain.await_complete()
    chain.processes.until(lambda: "bus0 works again" in log.read_text()[first:], "the end of the fault")


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (("type", "can", "bitrate", "500000"), "its bit rate is 500000 bit/s, the layout has 1000000 bit/s"),
        (("type", "can", "bitrate", "1000000", "listen-only", "on"), "it is listen-only"),
    ],
)
def test_named_command_mends_an_interface_that_is_refused(
    adapter: Adapter, settings: tuple[str, ...], words: str
) -> None:
    for state in ("up", "down"):
        ip_link("set", NAME, "down")
        ip_link("set", NAME, *settings)
        ip_link("set", NAME, state)
        with pytest.raises(BusError, match=words) as caught:
            open_link("socketcan", NAME, 1_000_000)
        (command,) = re.findall(r"'(ip link .*)'$", str(caught.value))
        subprocess.run(["sh", "-c", command], check=True)
        open_link("socketcan", NAME, 1_000_000).close()


def test_short_queue_is_told_with_the_command(adapter: Adapter, capsys: pytest.CaptureFixture[str]) -> None:
    ip_link("set", NAME, "txqueuelen", "3")
    open_link("socketcan", NAME, 1_000_000, name="gateway").close()
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("gateway: slcan0: its transmit queue has room for 3 frames")
    subprocess.run(["sh", "-c", line.split("'")[1]], check=True)
    open_link("socketcan", NAME, 1_000_000, name="gateway").close()
    assert capsys.readouterr().err == (
        "gateway: slcan0: 1000000 bit/s, no restart after bus-off, queue of 1000 frames, error-active\n"
    )
