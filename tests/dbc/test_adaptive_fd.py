"""Adaptive sums on CAN FD: one frame carries all groups of a block."""

from pathlib import Path
from typing import Any

import cantools
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dbc.adaptive import FINE_LIMIT, NO_CHECK, coarse_code, coarse_value, frame_of, hold
from dbc.configuration import configuration
from dbc.contract import Contract, sum_frame_bits
from dbc.database import database
from dbc.dictionary import dictionary
from dbc.eds import eds, node_types
from nodes.adaptive.sending import make_payload, new_groups
from skin.layout import load_layout
from tests.layouts import ADAPTIVE, BLOCK_SUMS, GROUPS, buses, small_layout


@pytest.fixture(scope="module")
def contract() -> Contract:
    return Contract.from_layout(load_layout(Path("adaptive-fd")))


def test_every_frame_of_127_nodes_has_an_identifier_of_its_own() -> None:
    nodes = Contract.from_layout(small_layout(64, 64, **ADAPTIVE, bus=buses(127, 1, fd=True))).on_bus(0)
    tpdos = [(node, tpdo) for node in nodes for tpdo in node.adaptive_tpdos]
    assert len({tpdo.cob_id for _, tpdo in tpdos}) == 8 * 127
    assert all(0x181 <= tpdo.cob_id < 0x580 for _, tpdo in tpdos)
    for node, tpdo in tpdos:
        assert frame_of(tpdo.cob_id, groups=GROUPS, is_fd=True) == (node.node_id - 1, tpdo.level, 0, tpdo.is_fine)
    order = [(tpdo.is_fine, -tpdo.level, node.node_id) for node, tpdo in sorted(tpdos, key=lambda each: each[1].cob_id)]
    assert order == sorted(order)


@pytest.mark.heavy
def test_the_mapping_fills_the_frame_and_is_proven(contract: Contract) -> None:
    node = contract.nodes[70]
    entries = {(each.index, each.subindex): int(each.value) for each in dictionary(contract, node) if each.subindex}
    proven = {(each.index, each.subindex) for each in configuration(contract, node)}
    assert [tpdo.number for tpdo in node.adaptive_tpdos] == list(range(1, 9))
    for tpdo in node.adaptive_tpdos:
        mapped = {key: value for key, value in entries.items() if key[0] == 0x1A00 + tpdo.number - 1}
        assert sum(value & 0xFF for value in mapped.values()) == 8 * tpdo.length
        assert tpdo.length == (64 if tpdo.is_fine else 32)
        assert {(0x1800 + tpdo.number - 1, 1), *mapped} <= proven
    (kind,) = node_types(contract)
    assert "NrOfTXPDO=8" in eds(contract, kind)


def test_a_frame_of_all_groups_takes_no_longer_than_a_classic_frame_of_one(contract: Contract) -> None:
    """At 1 and 5 Mbit/s; docs/adaptive.md names these bits."""
    line = contract.layout.bus[0]
    assert [sum_frame_bits(line, GROUPS, is_fine=is_fine) for is_fine in (False, True)] == [104, 168]


@pytest.mark.heavy
@given(st.integers(0, 2**32), st.floats(0, 20e-3))
@settings(deadline=None)
def test_a_fine_frame_alone_tells_all_sums(seed: int, size_n: float) -> None:
    law = Contract.from_layout(load_layout(Path("adaptive-fd"))).law
    sums_n = np.random.default_rng(seed).uniform(-16, 16, BLOCK_SUMS).astype(np.float32) * np.float32(size_n)
    sums_n[0] = 2 * abs(sums_n[0])
    groups, payload = new_groups(1, GROUPS, True), np.zeros(64, np.uint8)
    groups.is_fine[:] = 1
    assert make_payload(0, 0, sums_n, law, groups, payload) == 64
    value_n, coarse_n, check = np.zeros(BLOCK_SUMS), np.zeros(BLOCK_SUMS), np.full(GROUPS, NO_CHECK, np.int64)
    assert hold(payload, 0, True, True, law, value_n, coarse_n, check)
    for place, sum_n in enumerate(sums_n.tolist()):
        coarse = coarse_value(coarse_code(sum_n, place == 0, law), place == 0, law)
        assert coarse_n[place] == coarse
        is_in_reach = abs(sum_n - coarse) < (FINE_LIMIT - 1) * law.fine_n
        assert abs(value_n[place] - sum_n) <= (0.51 * law.fine_n if is_in_reach else abs(coarse - sum_n))


@pytest.mark.heavy
def test_cantools_decodes_all_groups() -> None:
    contract = Contract.from_layout(small_layout(16, 16, **ADAPTIVE, bus=buses(4, 4, fd=True)))
    described: Any = cantools.database.load_string(database(contract, 1), "dbc", strict=True)
    node, law = contract.on_bus(1)[3], contract.law
    coarse, fine = (next(each for each in node.adaptive_tpdos if each.is_fine is kind) for kind in (False, True))
    groups, payload = new_groups(1, GROUPS, True), np.zeros(64, np.uint8)
    groups.is_fine[:] = 1
    sums_n = np.random.default_rng(1).uniform(-0.01, 0.01, BLOCK_SUMS).astype(np.float32)
    make_payload(0, 0, sums_n, law, groups, payload)
    codes = payload[:BLOCK_SUMS].tolist()
    assert described.get_message_by_frame_id(coarse.cob_id).is_fd
    assert list(described.decode_message(coarse.cob_id, payload[:BLOCK_SUMS].tobytes()).values()) == codes
    signals = described.decode_message(fine.cob_id, payload.tobytes())
    names = [name for name in signals if "Row" in name and "Fine" not in name]
    assert [signals[name] for name in names] == codes
    low = [int(np.rint(float(each) / law.fine_n)) & 127 for each in sums_n]
    assert [signals[f"{name}_Fine"] for name in names] == low
    assert [signals[f"Check{group}"] for group in range(GROUPS)] == payload[39::8].tolist()
