"""The table of a board's constants is enough to make its sums and frames."""

import json
from pathlib import Path

import msgspec
import numpy as np
import pytest

from dbc import indices as od
from dbc.board import Board, board, board_text
from dbc.canopen import COB_ID_NO_RTR
from dbc.codec import encode
from dbc.configuration import signature
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


@pytest.mark.parametrize("name", ["default", "one-bus-12bit"])
def test_the_signature_follows_from_the_table_and_the_list_of_the_documents(name: str) -> None:
    contract = contract_of(name)
    table = board(contract, contract.nodes[-1])
    values: dict[tuple[int, int], bytes] = {}

    def put(index: int, subindex: int, value: int, size: int = 4) -> None:
        values[index, subindex] = value.to_bytes(size, "little")

    put(od.SYNC_COB_ID, 0, table.sync_cob_id)
    put(od.CYCLE_PERIOD_US, 0, table.sync_period_us)
    put(od.WINDOW_US, 0, table.sync_window_us)
    put(od.EMCY_COB_ID, 0, table.emcy_cob_id)
    put(od.HEARTBEAT_MS, 0, table.heartbeat_ms, 2)
    put(od.IDENTITY, 1, table.vendor_id)
    put(od.IDENTITY, 2, table.product_code)
    put(od.SYNC_OVERFLOW, 0, table.sync_overflow, 1)
    put(od.BLOCK, 0, table.blocks[0].block, 2)
    put(od.ENCODING, 0, table.encoding)
    values[od.PHI_FINGERPRINT, 0] = table.phi_fingerprint.encode()
    for place in range(len(table.blocks)):
        put(od.of_block(od.TEST_PATTERN, place), 0, 0, 1)
    for tpdo in table.tpdos:
        communication, mapping = od.TPDO_COMMUNICATION + tpdo.number - 1, od.TPDO_MAPPING + tpdo.number - 1
        put(communication, 1, tpdo.cob_id | COB_ID_NO_RTR)
        put(communication, 2, tpdo.transmission_type, 1)
        put(communication, 6, tpdo.sync_start_value, 1)
        put(mapping, 0, len(tpdo.mapping), 1)
        for subindex, each in enumerate(tpdo.mapping, 1):
            put(mapping, subindex, each.index << 16 | each.subindex << 8 | each.bits)
    assert table.signature == signature((*where, data) for where, data in sorted(values.items()))
