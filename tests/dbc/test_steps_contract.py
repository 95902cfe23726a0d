"""The contract of stepped nodes: identifiers, parts, mapping, slots, and a .dbc that other programs read."""

import re
import struct
from pathlib import Path
from typing import Any

import cantools
import numpy as np
import pytest

from canskin.errors import LayoutError
from dbc.configuration import configuration
from dbc.contract import Contract
from dbc.database import database
from dbc.dictionary import dictionary
from dbc.eds import dcfs, eds, node_types
from dbc.steps import Form, form_of
from skin.frontend import sum_step_n
from skin.layout import load_layout, parse_layout
from skin.walsh import walsh_matrix
from tests.layouts import STEPPED, buses, small_layout

TEXT = """
sending = "steps"
[taxels]
[measurement]
wiring = "board"
[sync]
rate_hz = 10.0
[steps]
slot_s = 0.005
"""
both = pytest.mark.parametrize("contract", ["steps", "steps-fd"], indirect=True)


@pytest.fixture(scope="module")
def contract(request: pytest.FixtureRequest) -> Contract:
    return Contract.from_layout(load_layout(Path(getattr(request, "param", "steps"))))


def values_of(contract: Contract, place: int) -> dict[tuple[int, int], Any]:
    return {(each.index, each.subindex or 0): each.value for each in dictionary(contract, contract.nodes[place])}


@pytest.mark.parametrize(
    ("size", "is_fd", "frames", "length"),
    [(8, False, 1, 8), (16, False, 1, 8), (32, False, 1, 8), (64, False, 2, 8), (8, True, 1, 8), (16, True, 1, 16),
     (32, True, 1, 32), (64, True, 1, 64)],
)  # fmt: skip
def test_a_bus_of_127_boards_has_an_identifier_for_every_frame(
    size: int, is_fd: bool, frames: int, length: int
) -> None:
    tables = STEPPED | {"measurement": {"wiring": "board", "block_size": size}}
    contract = Contract.from_layout(small_layout(127, size, **tables, bus=buses(127, fd=is_fd)))
    found = [(tpdo.cob_id, tpdo.length) for node in contract.nodes for tpdo in node.tpdos]
    expected = [base + node_id for node_id in range(1, 128) for base in (0x180, 0x280)[:frames]]
    assert found == [(cob_id, length) for cob_id in expected]


@both
def test_parts_are_numbered_by_node_and_make_up_its_frames(contract: Contract) -> None:
    is_fd = contract.layout.bus[0].fd
    table, of_node = contract.parts, 4 if is_fd else 1
    assert (
        contract.forms_of(1)
        == contract.nodes[-1].forms
        == tuple(form_of(8, has_first=part == 0) if is_fd else form_of(32) for part in range(of_node))
    )
    frame = int(table.row_of[1, 0x181])
    node = contract.on_bus(1)[0]
    assert (contract.nodes[table.node[frame]], table.parts[frame]) == (node, of_node)
    assert (table.length[frame], table.flags[frame]) == (32 if is_fd else 8, node.flags)
    parts = range(table.part[frame], table.part[frame] + of_node)
    assert [int(table.block[part]) for part in parts] == [node.block] * of_node
    assert [int(table.first[part]) for part in parts] == [0, 8, 16, 24][:of_node]
    assert [Form(*table.form[part].tolist()) for part in parts] == list(node.forms)
    assert (table.row_of >= 0).sum() == len(table.node) == 128


def test_sums_of_a_frame_stand_in_its_order(contract: Contract) -> None:
    node = contract.on_bus(2)[5]
    force_n = np.random.default_rng(1).uniform(0, 0.02, contract.layout.taxels.count)
    of_frame = contract.table.gather[contract.table.node == contract.nodes.index(node)].ravel()
    patch = force_n[contract.phi.taxels_of_blocks[node.block]]
    np.testing.assert_allclose(contract.phi.forward(force_n)[of_frame], walsh_matrix(32) @ patch, atol=1e-6)


@both
def test_dictionary_maps_slot_and_words_and_the_proof_covers_them(contract: Contract) -> None:
    values, parts = values_of(contract, 5), len(contract.nodes[5].forms)
    mapped = [values[0x1A00, place] for place in range(1, 1 + int(values[0x1A00, 0]))]
    assert mapped == [0x2022_0008, *(0x2110_0038 | part << 8 for part in range(1, parts + 1))]
    assert (values[0x1800, 1], values[0x1800, 2]) == (1 << 30 | 0x186, 254)
    assert (values[0x1019, 0], values[0x2005, 0]) == (240, 56 | 3 << 16 | 1 << 24)
    covered = {(each.index, each.subindex): each for each in configuration(contract, contract.nodes[5])}
    assert {(0x1800, 1), (0x1800, 2), *((0x1A00, place) for place in range(parts + 2)), (0x2005, 0)} <= {*covered}
    assert {index for index, _ in covered if 0x2030 <= index <= 0x2036} == {0x2031}
    assert covered[0x2031, 2].data == bytes((contract.slots,))
    assert struct.unpack("<f", covered[0x2007, 0].data)[0] == np.float32(contract.unit_n)
    assert contract.unit_n == sum_step_n(contract.layout) == 0.64 / 8192
    (kind,) = node_types(contract)
    assert len(kind.nodes) == 128
    assert "NrOfTXPDO=1" in eds(contract, kind)


@pytest.mark.parametrize(
    ("rate_hz", "steps", "types", "offsets_us"),
    [
        (10.0, {"slot_s": 0.005}, 254, [0, 2500]),
        (10.0, {"quiet": 0.0, "slot_s": 0.002}, 254, [0, 1000]),
        (200.0, {"slot_s": 0.005, "at_sync": True}, 0, [0, 0]),
        (200.0, {"slot_s": 0.005, "at_sync": True, "quiet": 0.0}, 1, [0, 0]),
    ],
)
def test_boards_send_at_their_places_or_at_sync(
    rate_hz: float, steps: dict[str, Any], types: int, offsets_us: list[int]
) -> None:
    tables = STEPPED | {"sync": {"rate_hz": rate_hz}, "steps": steps, "bus": buses(2, 2)}
    contract = Contract.from_layout(small_layout(8, 16, **tables))
    for bus in (0, 1):
        values = [values_of(contract, contract.nodes.index(node)) for node in contract.on_bus(bus)]
        assert [each[0x2031, 3] for each in values] == offsets_us
        assert {each[0x1800, 2] for each in values} == {types}
        assert {each[0x2031, 1] for each in values} == {steps.get("quiet", 0.1)}
        assert {each[0x2031, 2] for each in values} == {contract.slots}
    assert contract.slots == round(1 / rate_hz / steps["slot_s"])
    (kind,) = node_types(contract)
    assert [int(text.split("[2031sub3]")[1].split("ParameterValue=")[1].split()[0], 0) for _, text in
            dcfs(contract, kind)] == 2 * offsets_us  # fmt: skip


@both
def test_cantools_decodes_slot_and_words(contract: Contract) -> None:
    described: Any = cantools.database.load_string(database(contract, 1), "dbc", strict=True)
    (tpdo,), parts = contract.on_bus(1)[3].tpdos, len(contract.nodes[0].forms)
    words = [0x12_3456_789A_BCDE + part for part in range(parts)]
    payload = b"\x11" + b"".join(word.to_bytes(7, "little") for word in words)
    message = described.get_message_by_frame_id(tpdo.cob_id)
    assert (message.is_fd, message.length) == (parts > 1, tpdo.length)
    assert list(message.decode(payload.ljust(tpdo.length, b"\0")).values()) == [0x11, *words]
    rows = ", ".join(str(row) for row in contract.phi.row_of_sum[contract.table.gather[0]])
    assert rows.startswith("0, 4, 6, 2, ")
    assert rows in message.comment


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (('wiring = "board"', 'wiring = "scattered"'), "$.measurement.wiring"),
        (('wiring = "board"', 'wiring = "board"\nblock_size = 128'), "$.measurement.block_size"),
        (('wiring = "board"', 'wiring = "board"\nsums = 1024'), "$.measurement.sums"),
        (("[sync]", "[sync]\nturns = 2"), "$.sync.turns"),
        (("[sync]", "[sampling]\nrate_hz = 500\n[sync]"), "$.sampling.rate_hz"),
        (("[sync]", '[[bus]]\nname = "a"\nnodes = 64\nblocks_per_node = 2\n[sync]'), "$.bus[0].blocks_per_node"),
        (("slot_s = 0.005", "slot_s = 0.003"), "such as 0.00303030303, got 0.003 - at `$.steps.slot_s`"),
        (("slot_s = 0.005", "slot_s = 1"), "such as 0.1, got 1 - at `$.steps.slot_s`"),
        (("slot_s = 0.005", "slot_s = 0.0001"), "$.steps.slot_s"),
        (("rate_hz = 10.0", "rate_hz = 0.5"), "$.steps.slot_s"),
        (("rate_hz = 10.0", "rate_hz = 300.0"), "$.steps.slot_s"),
        (("slot_s = 0.005", "slot_s = 0.005\nat_sync = true"), "boards that send at SYNC expect 200"),
        (("slot_s = 0.005", "quiet = -0.1"), "$.steps.quiet"),
    ],
)
def test_layout_that_stepped_sending_cannot_have_is_refused(change: tuple[str, str], words: str) -> None:
    with pytest.raises(LayoutError) as refused:
        parse_layout(TEXT.replace(*change).encode(), "steps.toml")
    assert words in str(refused.value)


@pytest.mark.parametrize(("rate_hz", "slot_s", "slots"), [(10.0, 0.00303030303, 33), (30.0, 0.00333333333, 10)])
def test_slots_that_no_decimal_divides_may_be_rounded(rate_hz: float, slot_s: float, slots: int) -> None:
    text = TEXT.replace("rate_hz = 10.0", f"rate_hz = {rate_hz}").replace("slot_s = 0.005", f"slot_s = {slot_s}")
    assert parse_layout(text.encode(), "steps.toml").slots == slots


def test_slots_are_of_stepped_boards_alone() -> None:
    with pytest.raises(LayoutError, match=re.escape('needs `sending = "steps"`, got "synchronous"')):
        small_layout(steps={"quiet": 0.0})
    with pytest.raises(LayoutError, match=re.escape('needs `sending = "steps"`, got "synchronous"')):
        parse_layout(TEXT.replace('sending = "steps"', "").replace("0.005", "0.004").encode(), "steps.toml")


def test_a_bus_gets_as_many_boards_as_a_slot_has_time_for() -> None:
    for size, nodes in ((32, 32), (64, 16)):
        layout = parse_layout(TEXT.replace("[sync]", f"block_size = {size}\n[sync]").encode(), "steps.toml")
        assert {bus.nodes for bus in layout.bus} == {nodes}
