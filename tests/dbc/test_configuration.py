"""What a master compares of a node, and the signature of all of it."""

from pathlib import Path

import pytest

from dbc.configuration import configuration, expected_signature, signature
from dbc.contract import Contract
from skin.layout import load_layout

#: Objects of the whole node, as docs/bus.md lists them: index and sub-index.
OF_THE_NODE = [
    *[(0x1005, 0), (0x1006, 0), (0x1007, 0), (0x1014, 0), (0x1017, 0), (0x1018, 1), (0x1018, 2), (0x1019, 0)],
    *[(0x2000, 0), (0x2002, 0), (0x2005, 0)],
]


@pytest.mark.parametrize("name", ["default", "fd"])
def test_what_is_compared_is_what_the_bus_document_lists(name: str) -> None:
    contract = Contract.from_layout(load_layout(Path(name)))
    node = contract.nodes[0]
    communication = [(0x17FF + tpdo.number, each) for tpdo in node.tpdos for each in (1, 2, 6)]
    mapping = [(0x19FF + tpdo.number, each) for tpdo in node.tpdos for each in range(tpdo.sums + 1)]
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
