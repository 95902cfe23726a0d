"""Boards with node-IDs of the user's choice: identifiers, files, and what is refused."""

from typing import Any

import pytest

from canskin.errors import LayoutError
from dbc.contract import Contract
from dbc.dictionary import dictionary
from skin.layout import layout_text, parse_layout
from tests.layouts import STEPPED, small_layout


def contract_of(rows: int = 16, tables: dict[str, Any] | None = None, **bus: Any) -> Contract:
    blocks = rows * 16 // 32
    nodes = {} if "node_ids" in bus else {"nodes": blocks}
    line = {"name": "can0", **nodes, **bus}
    return Contract.from_layout(small_layout(rows, 16, **(tables or {}), bus=[line]))


def test_node_ids_follow_the_first_and_blocks_stay_in_order() -> None:
    contract = contract_of(first_node_id=33)
    assert [(node.node_id, node.block) for node in contract.nodes] == [(33 + each, each) for each in range(8)]
    assert contract.nodes[0].tpdos[0].cob_id == 0x180 + 33
    values = {(each.index, each.subindex): each.value for each in dictionary(contract, contract.nodes[2])}
    assert (values[0x1014, None], values[0x1200, 1]) == (0x80 + 35, 0x600 + 35)


def test_listed_node_ids_count_the_nodes() -> None:
    contract = contract_of(node_ids=[3, 5, 9, 10, 11, 50, 126, 127])
    assert [node.node_id for node in contract.on_bus(0)] == [3, 5, 9, 10, 11, 50, 126, 127]
    assert contract.layout.bus[0].nodes == 8
    assert parse_layout(layout_text(contract.layout).encode(), "again.toml") == contract.layout


@pytest.mark.parametrize("ids", [{"first_node_id": 90}, {"node_ids": [1, 7, 8, 60, 61, 62, 100, 127]}])
def test_no_identifier_comes_twice_where_a_node_has_more_tpdos_than_its_own_node_id_gives(ids: dict[str, Any]) -> None:
    # 128 sums of each node are 32 frames: four node-IDs' worth.
    other = {"name": "drive", "identifier": 0x205}
    contract = contract_of(64, {"measurement": {"sums": 1024}}, **ids, foreign=[other], blocks_per_node=4, nodes=8)
    identifiers = [tpdo.cob_id for node in contract.nodes for tpdo in node.tpdos]
    assert len(identifiers) == len(set(identifiers)) == 8 * 32
    # None is one that a device with the node-ID of a foreign message would have.
    assert not any(identifier & 0x7F in (0, 5) for identifier in identifiers)


def test_stepped_boards_have_identifiers_of_their_own_at_any_node_ids() -> None:
    contract = contract_of(16, dict(STEPPED), first_node_id=41)
    assert [tpdo.cob_id for node in contract.nodes for tpdo in node.tpdos] == list(range(0x180 + 41, 0x180 + 49))


@pytest.mark.parametrize(
    ("ids", "says"),
    [
        ({"first_node_id": 0}, "first_node_id"),
        ({"first_node_id": 121}, "expected 120 or less, for 8 node-IDs up to 127, got 121"),
        ({"node_ids": [1, 2, 3, 4, 5, 6, 7, 128]}, "128"),
        ({"node_ids": [1, 2, 3, 4, 5, 6, 7, 7]}, "ascending order, each once"),
        ({"node_ids": [2, 1, 3, 4, 5, 6, 7, 8]}, "ascending order, each once"),
        ({"node_ids": [1, 2], "nodes": 8}, "expected 8 node-IDs .`nodes`., or no `nodes`, got 2"),
        ({"node_ids": [1, 2, 3, 4, 5, 6, 7, 8], "first_node_id": 1}, "got both"),
    ],
)
def test_node_ids_that_cannot_be_are_refused(ids: dict[str, Any], says: str) -> None:
    with pytest.raises(LayoutError, match=says):
        contract_of(**ids)
