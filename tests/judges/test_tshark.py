"""Wireshark's CANopen dissector reads a log of the running skin: every kind of service, no malformed frame."""

import csv
import shutil
import subprocess
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

import can
import pytest

from skin.layout import load_layout
from tests.layouts import layout_toml
from tests.processes import PATIENCE_S, Processes, free_endpoint

pytestmark = [
    pytest.mark.heavy,
    pytest.mark.skipif(
        shutil.which("tshark") is None, reason="NOT TESTED: what tshark says of the skin's frames, for want of tshark"
    ),
]

LAYOUT = layout_toml(16, 16, name="judged", sync={"rate_hz": 10.0, "turns": 2})
NODES, TPDOS, CYCLES = 8, 2, 20
#: Function codes as the dissector numbers them.
NMT, SYNC_OR_EMCY, PDO1_TX, PDO2_TX, PDO3_TX, PDO4_TX, SDO_TX, SDO_RX, NMT_ERROR_CONTROL = 0, 1, 3, 5, 7, 9, 11, 12, 14
PDOS_TX = {PDO1_TX, PDO2_TX, PDO3_TX, PDO4_TX}
FIELDS = (
    "_ws.col.Info",
    "can.id",
    "canopen.function_code",
    "canopen.node_id",
    "canopen.sync.counter",
    "canopen.em.err_code",
    "canopen.nmt_ctrl.cd",
    "canopen.nmt_guard.state",
    "canopen.sdo.main_idx",
    "canopen.sdo.abort_code",
    "_ws.malformed",
    "_ws.expert.severity",
)


@pytest.fixture(scope="module")
def log(processes: Processes, folder: Path) -> Path:
    """Log a skin from power-up, as candump would, until every service has been used."""
    layout = folder / "judged.toml"
    layout.write_text(LAYOUT)
    assert load_layout(layout).blocks == NODES
    processes.skin("bus", "bus", "bus0")
    processes.await_words("bus", "ready")
    path = folder / "judged.log"
    with can.Bus(interface="canskin", channel="bus0") as bus, path.open("w") as sink:
        heard = record(bus, sink)
        endpoint = free_endpoint()
        processes.skin("nodes", "nodes", "--layout", str(layout), "--no-fabric")
        skip_to(heard, 0x700 + NODES)
        processes.skin("gateway", "gateway", "--layout", str(layout), "--listen", endpoint)
        for _ in range(CYCLES):
            skip_to(heard, 0x080)
        bus.send(can.Message(arbitration_id=0x080, is_extended_id=False))
        sink.write(line(can.Message(time.time(), 0x080, is_extended_id=False)))
        skip_to(heard, 0x081)
        skip_to(heard, 0x081)  # the node says that all is well again
        processes.stop("gateway")
        skip_to(heard, 0x701)  # a heartbeat
    return path


def line(message: can.Message) -> str:
    """Write a frame as `candump -L` does; python-can's own writer adds a direction, which tshark does not know."""
    return f"({message.timestamp:.6f}) bus0 {message.arbitration_id:03X}#{message.data.hex().upper()}\n"


def record(bus: can.BusABC, sink: TextIO) -> Iterator[int]:
    """Log what comes, and say which identifiers came."""
    while (message := bus.recv(PATIENCE_S)) is not None:
        sink.write(line(message))
        yield message.arbitration_id


def skip_to(heard: Iterator[int], can_id: int) -> None:
    patience_s = time.monotonic() + PATIENCE_S
    for each in heard:
        if each == can_id:
            return
        if time.monotonic() > patience_s:
            break
    pytest.fail(f"identifier {can_id:#x} never came")


@pytest.fixture(scope="module")
def judged(log: Path) -> list[dict[str, str]]:
    """Return what tshark makes of each frame."""
    fields = [part for field in FIELDS for part in ("-e", field)]
    command = ["tshark", "-r", str(log), "-d", "can.subdissector,canopen", "-T", "fields", *fields]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return list(csv.DictReader(done.stdout.splitlines(), FIELDS, delimiter="\t", restval=""))


def function(frame: dict[str, str]) -> int:
    return int(frame["canopen.function_code"], 16)


def test_every_frame_is_canopen_and_none_is_malformed(judged: list[dict[str, str]], log: Path) -> None:
    assert len(judged) == len(log.read_text().splitlines())
    for frame in judged:
        assert frame["canopen.function_code"], frame
        assert not frame["_ws.malformed"], frame
        assert not frame["_ws.expert.severity"], frame
        assert not frame["canopen.sdo.abort_code"], frame


def test_all_nodes_boot_and_are_started(judged: list[dict[str, str]]) -> None:
    control = [frame for frame in judged if function(frame) == NMT_ERROR_CONTROL]
    boots = [int(frame["canopen.node_id"], 16) for frame in control if int(frame["canopen.nmt_guard.state"], 16) == 0]
    assert sorted(boots) == list(range(1, NODES + 1))
    started = [frame for frame in judged if function(frame) == NMT and int(frame["canopen.nmt_ctrl.cd"], 16) == 1]
    assert len(started) >= 1
    # They were operational when the master let them go.
    assert {int(frame["canopen.nmt_guard.state"], 16) for frame in control} >= {0, 5, 127}


def test_sync_counts_and_every_node_answers_each_with_its_pdos(judged: list[dict[str, str]]) -> None:
    counters = [int(frame["canopen.sync.counter"]) for frame in judged if frame["canopen.sync.counter"]]
    assert counters == list(range(1, len(counters) + 1))
    assert len(counters) >= CYCLES
    sent = Counter((function(frame), frame["canopen.node_id"]) for frame in judged if function(frame) in PDOS_TX)
    assert len(sent) == NODES * TPDOS
    assert min(sent.values()) >= CYCLES // 2


def test_the_master_reads_every_dictionary(judged: list[dict[str, str]]) -> None:
    asked = {frame["canopen.node_id"] for frame in judged if function(frame) == SDO_RX}
    answered = {frame["canopen.node_id"] for frame in judged if function(frame) == SDO_TX}
    assert len(asked) == NODES
    assert answered == asked
    assert any(int(frame["canopen.sdo.main_idx"] or "0", 16) >= 0x2000 for frame in judged)


def test_a_sync_of_the_wrong_length_is_an_emergency_of_every_node(judged: list[dict[str, str]]) -> None:
    codes = Counter(frame["canopen.em.err_code"] for frame in judged if frame["canopen.em.err_code"])
    assert codes == {"0x8240": NODES, "0x0000": NODES}
