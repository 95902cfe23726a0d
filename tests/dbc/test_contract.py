"""The contract: identifiers, turns, frames and the codec."""

import math
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canskin.errors import LayoutError
from dbc import indices as od
from dbc.canopen import SYNC_COB_ID
from dbc.codec import decode, encode
from dbc.contract import (
    SUMS_MAX,
    Contract,
    sync_frame,
    useful_widths,
)
from dbc.dictionary import dictionary
from dbc.frame import BRS, FD, FD_LENGTHS
from dbc.packing import Packing
from skin.layout import SUM_BITS_MAX, SUM_BITS_MIN, Bus, Encoding, Layout, PhiParameters, Taxels, load_layout
from tests.layouts import TURNS, buses, in_one_instant, in_turns, small_layout

CONTRACT = Contract.from_layout(in_one_instant())
IN_TURNS = Contract.from_layout(load_layout())
#: 2022h, sub-index 0, 8 bits: the entry before the sums of a mapping.
COUNTER_ENTRY = 0x2022_00_08


def changed(**measurement: object) -> Layout:
    layout = in_one_instant()
    return msgspec.structs.replace(layout, measurement=msgspec.structs.replace(layout.measurement, **measurement))


def test_in_turns_half_of_the_same_frames_answers_odd_and_half_even_cycles() -> None:
    for node, taken in zip(CONTRACT.nodes, IN_TURNS.nodes, strict=True):
        assert [(each.cob_id, each.first_sum, each.sums) for each in node.tpdos] == [
            (each.cob_id, each.first_sum, each.sums) for each in taken.tpdos
        ]
        assert [tpdo.turn for tpdo in taken.tpdos] == [0, 1]


@pytest.mark.parametrize(
    ("contract", "kinds"),
    [(CONTRACT, [(1, 0), (1, 0)]), (IN_TURNS, [(2, 1), (2, 2)])],
    ids=TURNS,
)
def test_transmission_type_is_the_number_of_turns_and_the_start_value_names_the_turn(
    contract: Contract, kinds: list[tuple[int, int]]
) -> None:
    objects = {(each.index, each.subindex): each.value for each in dictionary(contract, contract.nodes[0])}
    assert [(objects[index, 2], objects[index, 6]) for index in (0x1800, 0x1801)] == kinds
    assert objects[0x1019, None] == 240


def test_sync_is_its_counter_whatever_makes_boards_send() -> None:
    sync = sync_frame(0xA5)
    assert (sync["can_id"][0], sync["length"][0], sync["data"][0, 0], sync["flags"][0]) == (0x80, 1, 0xA5, 0)
    stepped = Contract.from_layout(load_layout(Path("steps")))
    assert {each.value for each in dictionary(stepped, stepped.nodes[0]) if each.index == od.SYNC_OVERFLOW} == {240}


def test_too_many_frames_for_one_bus_is_an_error() -> None:
    text = (
        "[encoding]\nsum_bits = 16\n[measurement]\nsums = 4096\n"
        '[[bus]]\nname = "a"\nnodes = 127\n[[bus]]\nname = "b"\nnodes = 1\n'
    )
    layout = msgspec.toml.decode(text, type=Layout)
    with pytest.raises(LayoutError, match=r"put fewer nodes on `\$\.bus\[0\]`"):
        Contract.from_layout(layout)


@given(st.integers(0, 2**32 - 1), st.integers(0, 255))
def test_codec_round_trip_is_exact(seed: int, counter: int) -> None:
    assert CONTRACT.packing == Packing(14, 4, 0)
    sums = 4 * np.random.default_rng(seed).integers(-(2**13), 2**13, 1024)
    rows = CONTRACT.table.gather
    back = np.zeros(1024, np.int32)
    payloads = encode(counter, sums, rows, CONTRACT.packing)
    assert (payloads[:, 0] == counter).all()
    decode(payloads, rows, CONTRACT.packing, back)
    assert np.array_equal(back, sums)


def one_node(sums: int, bits: int, *, fd: bool) -> Contract:
    """Return a node of eight blocks of 16 taxels."""
    line = buses(1, fd=fd, blocks_per_node=8)
    measurement = {"sums": sums, "block_size": 16, "selection": "uniform"}
    return Contract.from_layout(small_layout(8, 16, measurement=measurement, encoding={"sum_bits": bits}, bus=line))


@pytest.mark.parametrize(
    ("sums", "bits", "fd", "parts", "lengths"),
    [
        # 56 bits of a classic frame: 8 of 7, 7 of 8, 5 of 11, 4 of 14, 3 of 16.
        (8, 14, False, [4, 4], [8, 8]),
        (5, 14, False, [4, 1], [8, 3]),
        (8, 16, False, [3, 3, 2], [7, 7, 5]),
        (9, 11, False, [5, 4], [8, 7]),
        (8, 8, False, [7, 1], [8, 2]),
        (8, 7, False, [8], [8]),
        # 504 bits of a CAN FD frame, and 63 sums at most.
        (33, 15, True, [33], [64]),
        (34, 15, True, [33, 1], [64, 3]),
        (64, 12, True, [42, 22], [64, 48]),
        (63, 8, True, [63], [64]),
        (64, 7, True, [53, 11], [48, 12]),
    ],
)
def test_sums_go_in_few_frames_of_few_bytes(
    sums: int, bits: int, fd: bool, parts: list[int], lengths: list[int]
) -> None:
    (node,) = one_node(sums, bits, fd=fd).nodes
    assert [(tpdo.sums, tpdo.length) for tpdo in node.tpdos] == list(zip(parts, lengths, strict=True))


def test_a_node_with_many_frames_has_identifiers_of_unused_node_ids() -> None:
    """Those of the predefined connection set, the four behind them, and then those of node-ID 2, which nobody has."""
    (node,) = one_node(10 * 4, 14, fd=False).nodes
    found = [tpdo.cob_id for tpdo in node.tpdos]
    assert found == [*(base + 1 for base in (0x180, 0x280, 0x380, 0x480, 0x200, 0x300, 0x400, 0x500)), 0x182, 0x282]


@pytest.mark.parametrize(
    ("sums", "fd", "widths"),
    [
        # 3 frames with 19 bytes, then 2 with 16, 14, 12 (10 and 9 bits) and 10, and 1 with 8.
        (8, False, [16, 14, 12, 10, 8, 7]),
        # 2 frames with 10 bytes (16 and 15 bits), then 1 with 8, 7, 6 and 5.
        (4, False, [16, 14, 12, 10, 8]),
        # 67 bytes, then 64, 48 and 32.
        (32, True, [16, 15, 11, 7]),
    ],
)
def test_of_the_widths_that_take_the_same_frames_the_widest_is_useful(sums: int, fd: bool, widths: list[int]) -> None:
    assert useful_widths(sums, fd=fd) == widths


def test_cycle_of_a_bus_is_its_sync_and_its_frames_by_priority() -> None:
    classic, fd = IN_TURNS.cycle(2, 1), Contract.from_layout(load_layout(Path("fd"))).cycle(0)
    assert len(classic) == 33
    assert set(classic["can_id"][1:] & 0x780) == {0x280}
    assert (classic["can_id"][0], classic["length"][0]) == (SYNC_COB_ID, 1)
    assert (np.diff(classic["can_id"].astype(int)) > 0).all()
    assert not classic["flags"].any()
    assert len(fd) == 33
    assert fd["flags"].tolist() == [0] + 32 * [FD | BRS]
    assert fd["length"].tolist() == [1] + 32 * [64]


@pytest.mark.parametrize("name", ["fd", "one-bus-12bit", "uniform"])
def test_nodes_map_the_counter_first_and_every_sum_once(name: str) -> None:
    layout = changed(selection="uniform") if name == "uniform" else load_layout(Path(name))
    contract = Contract.from_layout(layout)
    ids = [(node.bus, tpdo.cob_id) for node in contract.nodes for tpdo in node.tpdos]
    assert len(set(ids)) == len(ids)
    for node in contract.nodes:
        objects = dictionary(contract, node)
        places = [(each.index, each.subindex) for each in objects]
        assert len(set(places)) == len(places)
        by_place = {(each.index, each.subindex): each for each in objects}
        assert by_place[od.PHI_FINGERPRINT, None].value == contract.phi.fingerprint
        for place, tpdo in enumerate(node.tpdos):
            assert by_place[0x1A00 + place, 0].value == 1 + tpdo.sums
            assert by_place[0x1A00 + place, 1].value == COUNTER_ENTRY
        mapped = [int(each.value) for each in objects if 0x1A00 <= each.index < 0x1C00 and each.subindex and each.value]
        wanted = [
            od.of_block(od.SUMS, place) << 16 | sum_ << 8 | contract.packing.bits
            for place in range(node.blocks)
            for sum_ in range(1, len(contract.phi.rows_of(node.block + place)) + 1)
        ]
        assert sorted(mapped) == sorted(wanted + [COUNTER_ENTRY] * len(node.tpdos))
        assert all(by_place[entry >> 16, entry >> 8 & 0xFF or None].pdo for entry in mapped)


@settings(max_examples=60, deadline=None)
@given(
    bits=st.integers(SUM_BITS_MIN, SUM_BITS_MAX),
    blocks_per_node=st.sampled_from([1, 2, 4, 8]),
    fd=st.booleans(),
    sums=st.integers(8, 256),
    seed=st.integers(0, 99),
    turns=st.sampled_from(TURNS),
)
def test_any_skin_sends_every_sum_once_in_its_turns(
    bits: int, blocks_per_node: int, fd: bool, sums: int, seed: int, turns: int
) -> None:
    layout = Layout(
        taxels=Taxels(rows=16, columns=16),
        measurement=PhiParameters(selection="uniform", sums=sums, seed=seed),
        encoding=Encoding(sum_bits=bits),
        bus=[Bus(name="a", nodes=8 // blocks_per_node, blocks_per_node=blocks_per_node, fd=fd)],
    )
    contract = Contract.from_layout(in_turns(layout, turns))
    table = contract.table
    assert len(set(table.cob_id.tolist())) == len(table.cob_id)
    assert table.cob_id.min(initial=0x181) >= 0x181  # CiA 301, table 38
    assert table.cob_id.max(initial=0) < 0x580
    gathered = table.gather
    assert sorted(gathered[gathered >= 0]) == list(range(sums))
    assert set(table.length.tolist()) <= set(FD_LENGTHS if fd else range(1, 9))
    assert (8 * table.length.astype(int) >= 8 + (gathered >= 0).sum(1) * bits).all()
    room = min((504 if fd else 56) // bits, SUMS_MAX)
    for node in contract.nodes:
        assert len(node.tpdos) == min(node.sums, turns * math.ceil(node.sums / (turns * room)))
        of_turn = [sum(tpdo.turn == turn for tpdo in node.tpdos) for turn in range(turns)]
        assert max(of_turn) == min(of_turn) or node.sums < turns


@pytest.mark.parametrize(("sums", "frames"), [(63, [63]), (64, [53, 11])])
def test_a_can_fd_frame_maps_64_objects_at_most(sums: int, frames: list[int]) -> None:
    """Of 7 bits 72 sums would fit."""
    contract = one_node(sums, 7, fd=True)
    (node,) = contract.nodes
    objects = {(each.index, each.subindex): each.value for each in dictionary(contract, node)}
    assert [tpdo.sums for tpdo in node.tpdos] == frames
    for tpdo in node.tpdos:
        entries = [objects[0x19FF + tpdo.number, place] for place in range(1, 65)]
        assert objects[0x19FF + tpdo.number, 0] == 1 + tpdo.sums
        assert (0x19FF + tpdo.number, 65) not in objects
        assert [bool(each) for each in entries] == [True] * (1 + tpdo.sums) + [False] * (63 - tpdo.sums)


@pytest.mark.parametrize(
    ("fd", "data_bitrate", "flags"), [(False, None, 0), (True, None, FD), (True, 5_000_000, FD | BRS)]
)
def test_pdos_switch_the_rate_only_where_the_bus_has_a_second_one(
    fd: bool, data_bitrate: int | None, flags: int
) -> None:
    layout = load_layout()
    buses = [msgspec.structs.replace(bus, fd=fd, data_bitrate=data_bitrate) for bus in layout.bus]
    contract = Contract.from_layout(msgspec.structs.replace(layout, bus=buses))
    assert {node.flags for node in contract.nodes} == {flags}
    assert {node.pdo_bytes for node in contract.nodes} == {64 if fd else 8}


@pytest.mark.parametrize(
    ("name", "bits", "offset_binary", "encoding"),
    [
        ("default", 16, False, 0x01_00_00_10),
        ("default", 16, True, 0x01_01_00_10),
        ("default", 14, False, 0x01_00_02_0E),
        ("default", 12, True, 0x01_01_04_0C),
        ("default", 7, False, 0x01_00_0A_07),
        ("analogue", 12, False, 0x01_04_05_0C),
        ("analogue", 12, True, 0x01_05_06_0C),
    ],
)
def test_encoding_is_width_scale_form_and_blocks_by_byte(
    name: str, bits: int, offset_binary: bool, encoding: int
) -> None:
    encoded = Encoding(sum_bits=bits, offset_binary=offset_binary)
    layout = msgspec.structs.replace(load_layout(Path(name)), encoding=encoded)
    assert {node.encoding for node in Contract.from_layout(layout).nodes} == {encoding}
