"""The table of a board's constants is enough to make its sums and frames."""

import json
from pathlib import Path

import msgspec
import numpy as np
import pytest

from dbc import indices as od
from dbc.board import Board, board, board_text
from dbc.codec import encode
from dbc.contract import Contract
from skin.layout import load_layout

NAMES = ("default", "fd", "one-bus-12bit", "steps")


def contract_of(name: str) -> Contract:
    return Contract.from_layout(load_layout(Path(name)))


@pytest.mark.parametrize("name", NAMES)
def test_signs_and_taxels_are_the_rows_of_phi(name: str) -> None:
    contract = contract_of(name)
    counts = np.random.default_rng(3).integers(0, 1024, contract.phi.shape[1])
    sums = contract.phi.forward(counts)
    for node in (contract.nodes[0], contract.nodes[-1]):
        table = board(contract, node)
        made = [
            sum(int(f"{sign}{counts[taxel]}") for sign, taxel in zip(row, block.taxels, strict=True))
            for block in table.blocks
            for row in block.signs
        ]
        first = contract.phi.starts[node.block]
        assert made == sums[first : first + node.sums].tolist()


@pytest.mark.parametrize("name", ["default", "fd", "one-bus-12bit"])
def test_frames_made_from_the_table_are_those_of_the_contract(name: str) -> None:
    contract = contract_of(name)
    sums = contract.phi.forward(np.random.default_rng(4).integers(0, 1024, contract.phi.shape[1]))
    frames = contract.table
    payloads = encode(0xA5, sums, frames.gather, contract.packing)
    for row, (payload, length) in enumerate(zip(payloads, frames.length, strict=True)):
        node = contract.nodes[frames.node[row]]
        if node.node_id > 2:
            continue
        table = board(contract, node)
        (tpdo,) = (each for each in table.tpdos if each.cob_id == frames.cob_id[row])
        counter, *mapped = tpdo.mapping
        assert (counter.index, counter.subindex, counter.bits) == (od.SYNC_COUNTER, 0, 8)
        packed, bits = 0xA5, counter.bits
        assert table.packing is not None
        for entry in mapped:
            place, index = od.split_block(entry.index)
            assert (index, entry.bits) == (od.SUMS, table.packing.bits)
            value = int(sums[contract.phi.starts[node.block + place] + entry.subindex - 1])
            raw = int(contract.packing.raw(np.array([value]))[0])
            assert table.packing.raw_min <= raw <= table.packing.raw_max
            packed |= (raw & (1 << entry.bits) - 1) << bits
            bits += entry.bits
        assert tpdo.length == length
        assert packed.to_bytes(tpdo.length, "little")[: payload.size] == payload.tobytes()[: tpdo.length]


@pytest.mark.parametrize("name", NAMES)
def test_the_text_is_the_table(name: str) -> None:
    contract = contract_of(name)
    for node in (contract.nodes[0], contract.nodes[-1]):
        table = board(contract, node)
        text = board_text(table)
        assert msgspec.convert(json.loads(text), Board) == table
        assert text.endswith("}\n")
