"""The DBC files, read back: every frame decodes to exactly the sums that were packed."""

from pathlib import Path
from typing import Any

import cantools
import msgspec
import numpy as np
import pytest

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


@pytest.mark.heavy
@pytest.mark.parametrize(("rate", "switches"), [(5_000_000, "1"), (None, "0")])
def test_can_fd_frames_say_whether_they_switch_the_bit_rate(rate: int | None, switches: str) -> None:
    layout = load_layout(Path("fd"))
    buses = [msgspec.structs.replace(layout.bus[0], data_bitrate=rate)]
    described = read(Contract.from_layout(msgspec.structs.replace(layout, bus=buses)), 0)
    assert described.dbc.attribute_definitions["CANFD_BRS"].default_value == switches
    attributes = {name: each.value for name, each in described.dbc.attributes.items()}
    assert (attributes["BusType"], attributes["Baudrate"]) == ("CAN FD", 1_000_000)
    assert attributes["BaudrateCANFD"] == (rate or 1_000_000)
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
