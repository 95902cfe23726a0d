"""What a master compares of a node, and the signature of all of it."""

from pathlib import Path

import pytest

from dbc import indices as od
from dbc.configuration import Setting, configuration, expected_signature, proof_period_s, signature
from dbc.contract import Contract
from skin.layout import load_layout
from tests.layouts import TURNS, buses, in_turns, small_layout

#: Objects of the whole node, as docs/bus.md lists them: index and sub-index.
OF_THE_NODE = [
    *[(0x1005, 0), (0x1006, 0), (0x1007, 0), (0x1014, 0), (0x1017, 0), (0x1018, 1), (0x1018, 2), (0x1019, 0)],
    *[(0x2000, 0), (0x2002, 0), (0x2005, 0)],
]


@pytest.mark.parametrize("turns", TURNS)
@pytest.mark.parametrize("name", ["default", "fd"])
def test_what_is_compared_is_what_the_bus_document_lists(name: str, turns: int) -> None:
    contract = Contract.from_layout(in_turns(load_layout(Path(name)), turns))
    node = contract.nodes[0]
    communication = [(0x17FF + tpdo.number, each) for tpdo in node.tpdos for each in (1, 2, 6)]
    mapping = [(0x19FF + tpdo.number, each) for tpdo in node.tpdos for each in range(tpdo.sums + 2)]
    patterns = [(0x2021 + 0x200 * place, 0) for place in range(node.blocks)]
    compared = [(each.index, each.subindex) for each in configuration(contract, node)]
    assert compared == sorted(compared)
    assert compared == sorted([*OF_THE_NODE, *communication, *mapping, *patterns])


def test_signature_is_the_crc_of_ieee_802_3() -> None:
    assert signature([(0x3231, 0x33, b"456789")]) == 0xCBF4_3926  # the check value of "123456789"


def test_signatures_of_all_nodes_of_a_bus_differ() -> None:
    contract = Contract.from_layout(load_layout())
    nodes = contract.on_bus(0)
    assert len({expected_signature(configuration(contract, node)) for node in nodes}) == len(nodes)


def setting(data: bytes, data_type: int = od.UNSIGNED32) -> Setting:
    return Setting(0x1A00, 3, "TPDO mapping", data, data_type, is_writable=True)


def test_values_are_shown_as_people_write_them() -> None:
    assert str(setting(b"\x10")) == "1A00h:3 (TPDO mapping)"
    assert setting(b"\x10\x27").text() == "2710h"
    assert setting(b"\x10\x27").text(b"\xab\0") == "ABh"
    assert setting(b"abcd", od.VISIBLE_STRING).text(b"ab\xff") == "ab\ufffd"


@pytest.mark.parametrize(("bitrate", "period_s"), [(1_000_000, 2.0), (500_000, 3.456), (250_000, 6.912)])
def test_signatures_take_half_a_percent_of_a_bus_at_most(bitrate: int, period_s: float) -> None:
    """32 nodes, each a request and an answer of 135 bits."""
    layout = small_layout(32, 32, sync={"rate_hz": 20.0}, bus=buses(32, bitrate=bitrate))
    assert proof_period_s(Contract.from_layout(layout), 0) == pytest.approx(period_s)
