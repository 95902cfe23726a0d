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
from tests.layouts import buses, in_one_instant, small_layout

CASES = [
    ("default", {}),
    ("default", {"offset_binary": True}),
    *(("default", {"sum_bits": bits, "offset_binary": bits % 2 == 0}) for bits in range(7, 17)),
    ("fd", {}),
    *(("fd", {"sum_bits": bits, "offset_binary": bits % 2 == 1}) for bits in (7, 12, 16)),
    ("one-bus-12bit", {}),
    ("one instant", {}),
]
#: SYNC counter of the frames: its highest bit is set.
COUNTER = 0xA5


def made_of(name: str, encoding: dict[str, object]) -> Contract:
    layout = in_one_instant() if name == "one instant" else load_layout(Path(name))
    return Contract.from_layout(msgspec.structs.replace(layout, encoding=Encoding(**encoding)) if encoding else layout)


def read(contract: Contract, bus: int) -> Any:
    return cantools.database.load_string(database(contract, bus), "dbc", strict=True)


@pytest.mark.heavy
@pytest.mark.parametrize(("name", "encoding"), CASES)
def test_cantools_decodes_the_counter_and_exactly_the_sums(name: str, encoding: dict[str, object]) -> None:
    contract = made_of(name, encoding)
    sums = np.random.default_rng(5).integers(-16368, 16369, 1024).astype(np.int32)
    wanted = contract.packing.counts(contract.packing.raw(sums))
    names = {signal_name(contract, number): number for number in range(1024)}
    payloads = encode(COUNTER, sums, contract.table.gather, contract.packing)
    for bus in range(1 if encoding else len(contract.layout.bus)):  # buses differ in node-IDs only
        described = read(contract, bus)
        got: dict[int, int] = {}
        for row in np.flatnonzero(contract.table.bus == bus):
            message = described.get_message_by_frame_id(int(contract.table.cob_id[row]))
            assert message.length == contract.table.length[row]
            assert message.is_fd == contract.layout.bus[bus].fd
            payload = np.zeros(message.length, np.uint8)
            payload[: payloads.shape[1]] = payloads[row, : message.length]
            turn = "SYNC counters 1, 3, 5, ..." if contract.table.turn[row] == 0 else "SYNC counters 2, 4, 6, ..."
            assert message.comment.endswith(f", after {turn if contract.turns > 1 else 'every SYNC'}")
            signals = message.decode(payload.tobytes())
            assert signals.pop("Counter") == COUNTER
            for signal, value in signals.items():
                got[names[signal]] = value
        there = [number for node in contract.on_bus(bus) for number in range(*sums_of(contract, node))]
        assert got == {number: wanted[number] for number in there}


def sums_of(contract: Contract, node: Any) -> tuple[int, int]:
    return int(contract.phi.starts[node.block]), int(contract.phi.starts[node.block + node.blocks])


def test_signals_say_what_they_are() -> None:
    contract = made_of("default", {"sum_bits": 12, "offset_binary": True})
    described = read(contract, 1)
    message = described.get_message_by_name("Node6_TPDO2")
    assert (message.senders, message.cycle_time) == (["Node6"], 10)
    assert "after SYNC counters 2, 4, 6, ..." in message.comment
    counter, first, *_ = message.signals
    assert (counter.name, counter.start, counter.length, counter.is_signed) == ("Counter", 0, 8, False)
    assert (first.start, first.length) == (8, 12)
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
    assert (sync.cycle_time, sync.length) == (5, 1)
    assert described.decode_message("Node7_Heartbeat", b"\x05") == {"State": "Operational"}
    assert described.decode_message("NMT", b"\x81\x00") == {"Command": "Reset node", "NodeId": 0}


@pytest.mark.heavy
@pytest.mark.parametrize(("rate", "switches"), [(5_000_000, "1"), (None, "0")])
def test_can_fd_frames_say_whether_they_switch_the_bit_rate(rate: int | None, switches: str) -> None:
    layout = load_layout(Path("fd"))
    buses = [msgspec.structs.replace(layout.bus[0], data_bitrate=rate)]
    described = read(Contract.from_layout(msgspec.structs.replace(layout, bus=buses)), 0)
    assert described.dbc.attribute_definitions["CANFD_BRS"].default_value == switches
    assert {message.is_fd for message in described.messages if "TPDO" in message.name} == {True}
    assert not described.get_message_by_name("SYNC").is_fd


#: One node on CAN FD, with every message that the gateway sends to all nodes.
ARM: dict[str, Any] = {
    "name": "small",
    "measurement": {"sums": 5, "block_size": 64},
    "sync": {"rate_hz": 50.0, "turns": 2, "time_s": 2.5},
    "encoding": {"sum_bits": 12},
    "bus": buses(1, names=["arm"], bitrate=500_000, fd=True, data_bitrate=2_000_000),
}

#: Identifiers of CiA 301's predefined connection set, fields of its 7.2.
SERVICES = """\
BO_ 0 NMT: 2 Gateway
 SG_ Command : 0|8@1+ (1,0) [0|255] "" Vector__XXX
 SG_ NodeId : 8|8@1+ (1,0) [0|255] "" Vector__XXX

BO_ 128 SYNC: 1 Gateway
 SG_ Counter : 0|8@1+ (1,0) [0|255] "" Vector__XXX

BO_ 129 Node1_EMCY: 8 Node1
 SG_ ErrorCode : 0|16@1+ (1,0) [0|65535] ""  Gateway
 SG_ ErrorRegister : 16|8@1+ (1,0) [0|255] ""  Gateway
 SG_ ManufacturerField : 24|40@1+ (1,0) [0|1099511627775] ""  Gateway

BO_ 256 TIME: 6 Gateway
 SG_ AfterMidnight : 0|28@1+ (1,0) [0|268435455] "ms" Vector__XXX
 SG_ Days : 32|16@1+ (1,0) [0|65535] "d" Vector__XXX

"""
TRANSFERS = """\
BO_ 1409 Node1_SDO_Response: 8 Node1
 SG_ Command : 0|8@1+ (1,0) [0|255] ""  Gateway
 SG_ Index : 8|16@1+ (1,0) [0|65535] ""  Gateway
 SG_ Subindex : 24|8@1+ (1,0) [0|255] ""  Gateway
 SG_ Data : 32|32@1+ (1,0) [0|4294967295] ""  Gateway

BO_ 1537 Node1_SDO_Request: 8 Gateway
 SG_ Command : 0|8@1+ (1,0) [0|255] ""  Node1
 SG_ Index : 8|16@1+ (1,0) [0|65535] ""  Node1
 SG_ Subindex : 24|8@1+ (1,0) [0|255] ""  Node1
 SG_ Data : 32|32@1+ (1,0) [0|4294967295] ""  Node1

BO_ 1793 Node1_Heartbeat: 1 Node1
 SG_ State : 0|8@1+ (1,0) [0|255] ""  Gateway
"""


def test_services_are_written_field_by_field() -> None:
    text = database(Contract.from_layout(small_layout(**ARM)), 0)
    assert SERVICES in text
    assert TRANSFERS in text
    lines = text.splitlines()
    for head, starts in (("BO_ 385 Node1_TPDO1: 6 Node1", (8, 20, 32)), ("BO_ 641 Node1_TPDO2: 4 Node1", (8, 20))):
        begin = lines.index(head) + 1
        counter, *sums = lines[begin : lines.index("", begin)]
        assert counter == ' SG_ Counter : 0|8@1+ (1,0) [0|255] ""  Gateway'
        assert [line.split(" : ")[1] for line in sums] == [
            f'{start}|12@1- (32,0) [-65536|65504] "count"  Gateway' for start in starts
        ]


def test_attributes_tell_rates_formats_and_periods() -> None:
    """VFrameFormat 14 is StandardCAN_FD; a TPDO of one of two turns comes every second cycle of 20 ms."""
    text = database(Contract.from_layout(small_layout(**ARM)), 0)
    kinds = "BA_DEF_ ", "BA_DEF_DEF_ ", "BA_ ", "VAL_ "
    lines = [line for line in text.splitlines() if line.startswith(kinds) and "PhiFingerprint" not in line]
    reserved = 10 * ["reserved"]
    formats = '","'.join(
        ["StandardCAN", "ExtendedCAN", "reserved", "J1939PG", *reserved, "StandardCAN_FD", "ExtendedCAN_FD"]
    )
    assert lines == [
        'BA_DEF_  "DBName" STRING ;',
        'BA_DEF_  "BusType" STRING ;',
        'BA_DEF_  "Baudrate" INT 0 2147483647;',
        'BA_DEF_  "BaudrateCANFD" INT 0 2147483647;',
        'BA_DEF_  "NewtonPerCount" FLOAT 0 1000000;',
        'BA_DEF_ BO_  "GenMsgCycleTime" INT 0 65535;',
        f'BA_DEF_ BO_  "VFrameFormat" ENUM  "{formats}";',
        'BA_DEF_ BO_  "CANFD_BRS" ENUM  "0","1";',
        'BA_DEF_DEF_  "DBName" "";',
        'BA_DEF_DEF_  "BusType" "";',
        'BA_DEF_DEF_  "Baudrate" 0;',
        'BA_DEF_DEF_  "BaudrateCANFD" 0;',
        'BA_DEF_DEF_  "NewtonPerCount" 0.0;',
        'BA_DEF_DEF_  "GenMsgCycleTime" 0;',
        'BA_DEF_DEF_  "VFrameFormat" "StandardCAN";',
        'BA_DEF_DEF_  "CANFD_BRS" "1";',
        'BA_ "DBName" "arm";',
        'BA_ "BusType" "CAN FD";',
        'BA_ "BaudrateCANFD" 2000000;',
        'BA_ "NewtonPerCount" 1.9550342130987292e-05;',
        'BA_ "Baudrate" 500000;',
        'BA_ "GenMsgCycleTime" BO_ 128 20;',
        'BA_ "GenMsgCycleTime" BO_ 256 2500;',
        'BA_ "GenMsgCycleTime" BO_ 385 40;',
        'BA_ "VFrameFormat" BO_ 385 14;',
        'BA_ "GenMsgCycleTime" BO_ 641 40;',
        'BA_ "VFrameFormat" BO_ 641 14;',
        'BA_ "GenMsgCycleTime" BO_ 1793 1000;',
        'VAL_ 0 Command 1 "Start" 2 "Stop" 128 "Enter pre-operational" 129 "Reset node" 130 "Reset communication" ;',
        'VAL_ 1793 State 0 "Boot-up" 4 "Stopped" 5 "Operational" 127 "Pre-operational" ;',
    ]


def comments(**changed: Any) -> list[str]:
    text = database(Contract.from_layout(small_layout(**ARM | changed)), 0)
    return [line for line in text.splitlines() if line.startswith("CM_")]


def test_comments_say_what_a_frame_is() -> None:
    """A sum that is rounded to 32 counts is off by 16 of them at most: 16 * 19.55 µN = 313 µN."""
    bus, *messages = comments()
    assert bus.startswith('CM_ "Bus arm of skin small: blocks 0 to 0 of Phi ')
    exact = "Sums are in ADC counts, 1.95503e-05 N each; "
    assert bus.endswith(f'{exact}rounded to 32, which adds at most 0.000313 N to a sum.";')
    wide = comments(encoding={"sum_bits": 16})
    assert wide[0].endswith(f'{exact}rounded to 2, which adds at most 1.96e-05 N to a sum.";')
    small = {"measurement": {"sums": 4}, "bus": buses(2, names=["arm"], fd=True), "encoding": {"sum_bits": 16}}
    assert comments(**small)[0].endswith(f'{exact}they are exact.";')
    assert messages == [
        'CM_ BO_ 0 "NMT command; node-ID 0 is all nodes";',
        'CM_ BO_ 128 "All blocks measure now; the counter goes from 1 to 240";',
        'CM_ BO_ 256 "TIME_OF_DAY in UTC; days since 1984-01-01";',
        'CM_ BO_ 385 "Sums 0 to 2, after SYNC counters 1, 3, 5, ...";',
        'CM_ BO_ 641 "Sums 3 to 4, after SYNC counters 2, 4, 6, ...";',
    ]
    plain = comments(sync={"rate_hz": 50.0})[1:]
    assert plain[1:] == [messages[1], 'CM_ BO_ 385 "Sums 0 to 4, after every SYNC";']
