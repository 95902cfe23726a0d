"""The DBC files, read back: every frame decodes to exactly the sums that were packed."""

from pathlib import Path
from typing import Any

import cantools
import msgspec
import numpy as np
import pytest

from dbc.canopen import HEARTBEAT_BASE, SYNC_COB_ID
from dbc.codec import encode
from dbc.contract import Contract
from dbc.database import database, signal_name
from skin.layout import Encoding, load_layout
from tests.identity import alternating

CASES = [
    ("default", {}),
    ("default", {"offset_binary": True}),
    ("default", {"sum_bits": 12}),
    ("default", {"sum_bits": 8, "offset_binary": True}),
    ("fd", {}),
    ("fd", {"sum_bits": 12, "offset_binary": True}),
    ("one-bus-12bit", {}),
    ("alternating", {}),
]


def made_of(name: str, encoding: dict[str, object]) -> Contract:
    layout = alternating(load_layout()) if name == "alternating" else load_layout(Path(name))
    return Contract.from_layout(msgspec.structs.replace(layout, encoding=Encoding(**encoding)) if encoding else layout)


def read(contract: Contract, bus: int) -> Any:
    return cantools.database.load_string(database(contract, bus), "dbc", strict=True)


@pytest.mark.parametrize(("name", "encoding"), CASES)
def test_cantools_decodes_exactly_the_sums(name: str, encoding: dict[str, object]) -> None:
    contract = made_of(name, encoding)
    sums = np.random.default_rng(5).integers(-16368, 16369, 1024).astype(np.int32)
    wanted = contract.packing.counts(contract.packing.raw(sums))
    names = {signal_name(contract, number): number for number in range(1024)}
    payloads = encode(sums, contract.table.gather, contract.packing)
    for bus in range(1 if encoding else len(contract.layout.bus)):  # buses differ in node-IDs only
        described = read(contract, bus)
        got: dict[tuple[int, int], int] = {}
        for row in np.flatnonzero(contract.table.bus == bus):
            message = described.get_message_by_frame_id(int(contract.table.cob_id[row]))
            assert message.length == contract.table.length[row]
            assert message.is_fd == contract.layout.bus[bus].fd
            payload = np.zeros(message.length, np.uint8)
            payload[: payloads.shape[1]] = payloads[row, : message.length]
            phase = int(contract.table.phase[row])
            if contract.phases > 1:
                assert f"_Phase{phase + 1}" in message.name
                assert f"in phase {phase + 1} of 2" in message.comment
            else:
                assert "after every SYNC" in message.comment
            for signal, value in message.decode(payload.tobytes()).items():
                got[phase, names[signal]] = value
        there = [number for node in contract.on_bus(bus) for number in range(*sums_of(contract, node))]
        assert got == {(phase, number): wanted[number] for phase in range(contract.phases) for number in there}


def sums_of(contract: Contract, node: Any) -> tuple[int, int]:
    return int(contract.phi.starts[node.block]), int(contract.phi.starts[node.block + node.blocks])


def test_signals_say_what_they_are() -> None:
    contract = Contract.from_layout(alternating(made_of("default", {"sum_bits": 12, "offset_binary": True}).layout))
    described = read(contract, 1)
    message = described.get_message_by_name("Node6_TPDO3_Phase2")
    assert (message.senders, message.cycle_time) == (["Node6"], 20)
    assert "after SYNC counters 2, 4, 6, ..." in message.comment
    first = message.signals[0]
    assert (first.scale, first.offset, first.unit) == (16, -0x555 * 16, "count")
    assert (first.minimum, first.maximum) == (-0x555 * 16, (4095 - 0x555) * 16)
    assert first.name.startswith("Block037_Row")
    attributes = {name: each.value for name, each in described.dbc.attributes.items()}
    assert attributes["NewtonPerCount"] == contract.layout.taxels.newton_per_count
    assert attributes["PhiFingerprint"] == contract.phi.fingerprint
    assert (attributes["BusType"], attributes["Baudrate"]) == ("CAN", 1_000_000)


def test_every_frame_on_a_bus_is_described() -> None:
    contract = made_of("default", {})
    described = read(contract, 3)
    ids = {message.frame_id for message in described.messages}
    assert set(contract.cycle(3)["can_id"].tolist()) <= ids
    for base in (0x80, 0x580, 0x600, HEARTBEAT_BASE):
        assert set(range(base + 1, base + 33)) <= ids
    assert len(ids) == 2 + 32 * 2 + 4 * 32
    sync = described.get_message_by_frame_id(SYNC_COB_ID)
    assert (sync.cycle_time, sync.length) == (10, 0)
    assert described.decode_message("Node7_Heartbeat", b"\x05") == {"State": "Operational"}
    assert described.decode_message("NMT", b"\x81\x00") == {"Command": "Reset node", "NodeId": 0}


@pytest.mark.parametrize(("rate", "switches"), [(5_000_000, "1"), (None, "0")])
def test_can_fd_frames_say_whether_they_switch_the_bit_rate(rate: int | None, switches: str) -> None:
    layout = load_layout(Path("fd"))
    buses = [msgspec.structs.replace(layout.bus[0], data_bitrate=rate)]
    described = read(Contract.from_layout(msgspec.structs.replace(layout, bus=buses)), 0)
    assert described.dbc.attribute_definitions["CANFD_BRS"].default_value == switches
    assert {message.is_fd for message in described.messages if "TPDO" in message.name} == {True}
    assert not described.get_message_by_name("SYNC").is_fd
