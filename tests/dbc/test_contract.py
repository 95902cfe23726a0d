"""The contract: identifiers, phases and the codec."""

from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from canskin.errors import LayoutError
from dbc import indices as od
from dbc.adaptive import coarse_value
from dbc.canopen import SYNC_COB_ID
from dbc.codec import decode, encode
from dbc.contract import PHASES, Contract, _cob_id, _length, _spread, sample_age_ns, sum_frame_bits
from dbc.dictionary import dictionary
from dbc.frame import BRS, FD, FD_LENGTHS
from skin.layout import Bus, Encoding, Layout, PhiParameters, Taxels, load_layout
from skin.sync_counter import SYNC_OVERFLOW, next_counter
from tests.layouts import GROUPS, IDENTITIES, alternating, with_identity

CONTRACT = Contract.from_layout(load_layout())
ALTERNATING = Contract.from_layout(alternating(load_layout()))


def changed(**measurement: object) -> Layout:
    layout = load_layout()
    return msgspec.structs.replace(layout, measurement=msgspec.structs.replace(layout.measurement, **measurement))


def test_default_skin_uses_the_predefined_connection_set() -> None:
    node = CONTRACT.on_bus(1)[5]
    assert (node.node_id, node.block, node.sums) == (6, 37, 8)
    assert [tpdo.cob_id for tpdo in node.tpdos] == [0x186, 0x286]
    assert [tpdo.phase for tpdo in node.tpdos] == [0, 0]
    assert {tpdo.length for tpdo in node.tpdos} == {8}


def test_alternating_skin_has_a_set_of_tpdos_for_odd_and_one_for_even_cycles() -> None:
    node = ALTERNATING.on_bus(1)[5]
    assert [tpdo.cob_id for tpdo in node.tpdos] == [0x186, 0x286, 0x386, 0x486]
    assert [tpdo.phase for tpdo in node.tpdos] == [0, 0, 1, 1]


@pytest.mark.parametrize(
    ("contract", "kind"),
    [(CONTRACT, (0, 1, 0)), (ALTERNATING, (240, 2, 1))],
    ids=IDENTITIES,
)
def test_stock_boards_need_no_counter_and_no_start_value(contract: Contract, kind: tuple[int, int, int]) -> None:
    objects = {(each.index, each.subindex): each.value for each in dictionary(contract, contract.nodes[0])}
    assert (objects[0x1019, None], objects[0x1800, 2], objects[0x1800, 6]) == kind
    assert contract.sync(7)["length"].tolist() == [int(kind[0] > 0)]


def test_adaptive_nodes_have_a_counter_whatever_the_identity() -> None:
    contract = Contract.from_layout(load_layout(Path("adaptive")))
    assert (contract.sync_overflow, contract.layout.is_stock) == (SYNC_OVERFLOW, False)


def test_one_cycle_is_256_frames() -> None:
    for contract in (CONTRACT, ALTERNATING):
        for phase in range(contract.phases):
            assert (contract.table.phase == phase).sum() == 256


@pytest.mark.parametrize("seed", range(1, 12))
def test_uniform_rows_find_identifiers(seed: int) -> None:
    contract = Contract.from_layout(alternating(changed(selection="uniform", seed=seed)))
    assert contract.phi.shape[0] == 1024
    for bus in range(4):
        ids = [tpdo.cob_id for node in contract.on_bus(bus) for tpdo in node.tpdos]
        assert len(ids) == len(set(ids))
        # Outside what CiA 301, table 38 restricts.
        assert all(0x181 <= cob_id < 0x580 for cob_id in ids)
    for phase in range(contract.phases):
        gathered = contract.table.gather[contract.table.phase == phase]
        assert sorted(gathered[gathered >= 0]) == list(range(1024))


def test_too_many_frames_for_one_bus_is_an_error() -> None:
    text = (
        '[sync]\nidentity = "alternating"\n[measurement]\nsums = 2560\n'
        '[[bus]]\nname = "a"\nnodes = 127\n[[bus]]\nname = "b"\nnodes = 1\n'
    )
    layout = msgspec.toml.decode(text, type=Layout)
    with pytest.raises(LayoutError, match=r"put fewer nodes on `\$\.bus\[0\]`"):
        Contract.from_layout(layout)


def test_phases_take_turns_across_the_overflow() -> None:
    counter, seen = 1, []
    for _ in range(2 * SYNC_OVERFLOW):
        seen.append(ALTERNATING.phase_of(counter))
        counter = next_counter(counter)
    assert seen == [0, 1] * SYNC_OVERFLOW


@given(st.integers(0, 2**32 - 1))
def test_codec_round_trip_is_exact(seed: int) -> None:
    sums = np.random.default_rng(seed).integers(-(2**15), 2**15, 1024).astype(np.int16)
    rows = CONTRACT.table.gather[CONTRACT.table.phase == 0]
    back = np.zeros(1024, np.int32)
    decode(encode(sums, rows, CONTRACT.packing), rows, CONTRACT.packing, back)
    assert np.array_equal(back, sums)


def test_dictionary_maps_each_sum_once_per_phase() -> None:
    contract: Contract = Contract.from_layout(changed(selection="uniform"))
    for node in contract.nodes[:16]:
        objects = {(each.index, each.subindex): each for each in dictionary(contract, node)}
        assert objects[od.PHI_FINGERPRINT, None].value == contract.phi.fingerprint
        mapped = [
            int(each.value)
            for (index, subindex), each in objects.items()
            if 0x1A00 <= index < 0x1C00 and subindex and each.value
        ]
        wanted = [od.SUMS << 16 | place << 8 | 16 for place in range(1, node.sums + 1)]
        assert sorted(mapped) == sorted(wanted * contract.phases)


@pytest.mark.parametrize(
    ("sums", "bits", "fd", "parts", "lengths"),
    [
        (8, 16, False, [4, 4], [8, 8]),
        (5, 16, False, [4, 1], [8, 2]),
        (8, 12, False, [4, 4], [6, 6]),
        (9, 12, False, [5, 4], [8, 6]),
        (5, 12, False, [5], [8]),
        (8, 8, False, [8], [8]),
        (0, 16, False, [], []),
        (8, 16, True, [8], [16]),
        (32, 16, True, [32], [64]),
        (64, 12, True, [32, 32], [48, 48]),
        (64, 8, True, [64], [64]),
        (33, 16, True, [32, 1], [64, 2]),
    ],
)
def test_sums_go_in_few_frames_of_few_bytes(
    sums: int, bits: int, fd: bool, parts: list[int], lengths: list[int]
) -> None:
    spread = _spread(range(100, 100 + sums), bits, fd=fd)
    assert [len(part) for part in spread] == parts
    assert [each for part in spread for each in part] == list(range(100, 100 + sums))
    assert [_length(len(part), bits, fd=fd) for part in spread] == lengths


def test_cycle_of_a_bus_is_its_sync_and_its_frames_by_priority() -> None:
    classic, fd = ALTERNATING.cycle(2, 1), Contract.from_layout(load_layout(Path("fd"))).cycle(0)
    assert len(classic) == 65
    assert (classic["can_id"][0], classic["length"][0]) == (SYNC_COB_ID, 1)
    assert (np.diff(classic["can_id"].astype(int)) > 0).all()
    assert not classic["flags"].any()
    assert len(fd) == 33
    assert fd["flags"].tolist() == [0] + 32 * [FD | BRS]
    assert fd["length"].tolist() == [0] + 32 * [64]


@pytest.mark.parametrize("name", ["fd", "one-bus-12bit"])
def test_nodes_of_several_blocks_map_every_sum_once_per_phase(name: str) -> None:
    contract = Contract.from_layout(load_layout(Path(name)))
    ids = [tpdo.cob_id for node in contract.nodes for tpdo in node.tpdos]
    assert len(set(ids)) == len(ids)
    for node in contract.nodes:
        objects = dictionary(contract, node)
        places = [(each.index, each.subindex) for each in objects]
        assert len(set(places)) == len(places)
        by_place = {(each.index, each.subindex): each for each in objects}
        mapped = [int(each.value) for each in objects if 0x1A00 <= each.index < 0x1C00 and each.subindex and each.value]
        wanted = [
            od.of_block(od.SUMS, place) << 16 | sum_ << 8 | contract.packing.bits
            for place in range(node.blocks)
            for sum_ in range(1, len(contract.phi.rows_of(node.block + place)) + 1)
        ]
        assert sorted(mapped) == sorted(wanted * contract.phases)
        assert all(by_place[entry >> 16, entry >> 8 & 0xFF].pdo for entry in mapped)


def test_encoding_tells_nodes_apart_that_frames_do_not() -> None:
    layout = load_layout()
    encodings = {
        Contract.from_layout(msgspec.structs.replace(layout, encoding=Encoding(sum_bits=bits, offset_binary=offset)))
        .nodes[0]
        .encoding
        for bits in (16, 12, 8)
        for offset in (False, True)
    }
    assert len(encodings) == 6


@settings(max_examples=60, deadline=None)
@given(
    bits=st.sampled_from([16, 12, 8]),
    blocks_per_node=st.sampled_from([1, 2, 4, 8]),
    fd=st.booleans(),
    sums=st.integers(8, 256),
    seed=st.integers(0, 99),
    identity=st.sampled_from(IDENTITIES),
)
def test_any_skin_sends_every_sum_once_per_phase(
    bits: int, blocks_per_node: int, fd: bool, sums: int, seed: int, identity: str
) -> None:
    layout = Layout(
        taxels=Taxels(rows=16, columns=16),
        measurement=PhiParameters(selection="uniform", sums=sums, seed=seed),
        encoding=Encoding(sum_bits=bits),
        bus=[Bus(name="a", nodes=8 // blocks_per_node, blocks_per_node=blocks_per_node, fd=fd)],
    )
    contract = Contract.from_layout(with_identity(layout, identity))
    assert contract.phases == PHASES[identity]
    table = contract.table
    assert len(set(table.cob_id.tolist())) == len(table.cob_id)
    for phase in range(contract.phases):
        gathered = table.gather[table.phase == phase]
        assert sorted(gathered[gathered >= 0]) == list(range(sums))
        lengths = table.length[table.phase == phase]
        assert set(lengths.tolist()) <= set(FD_LENGTHS if fd else range(1, 9))
        assert (8 * lengths.astype(int) >= (gathered >= 0).sum(1) * bits).all()


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
    ("bits", "offset_binary", "encoding"),
    [(16, False, 0x01_00_00_10), (16, True, 0x01_01_00_10), (12, False, 0x01_00_04_0C), (12, True, 0x01_01_04_0C)],
)
def test_encoding_is_width_scale_sign_and_blocks_by_byte(bits: int, offset_binary: bool, encoding: int) -> None:
    layout = msgspec.structs.replace(load_layout(), encoding=Encoding(sum_bits=bits, offset_binary=offset_binary))
    assert {node.encoding for node in Contract.from_layout(layout).nodes} == {encoding}


@pytest.mark.parametrize(
    ("nodes", "node_id", "index", "cob_id"),
    [
        (32, 5, 3, 0x485),
        (32, 5, 4, 0x205),
        (32, 5, 7, 0x505),
        (32, 5, 8, 0x180 + 5 + 32),
        (32, 32, 16, 0x180 + 32 + 64),
        (126, 1, 8, 0x180 + 127),
        (126, 2, 8, None),
        (127, 127, 7, 0x57F),
        (32, 32, 24, None),  # 32 + 96 is no node-ID
        (32, 31, 24, 0x180 + 127),
    ],
)
def test_a_node_with_many_frames_has_identifiers_of_unused_node_ids(
    nodes: int, node_id: int, index: int, cob_id: int | None
) -> None:
    bus = Bus(name="a", nodes=nodes)
    if cob_id is not None:
        assert _cob_id(bus, 0, node_id - 1, index) == cob_id
    else:
        with pytest.raises(LayoutError, match=f"no identifiers left for TPDO {index + 1} of node {node_id}: "):
            _cob_id(bus, 0, node_id - 1, index)


def test_a_frame_of_adaptive_sums_takes_135_bits_and_tells_of_a_sample_a_millisecond_before() -> None:
    line = load_layout(Path("adaptive")).bus[0]
    assert [sum_frame_bits(line, GROUPS, is_fine=is_fine) for is_fine in (False, True)] == [135, 135]
    assert sample_age_ns(line, GROUPS) == 1_000_000 + 135_000
    slow = msgspec.structs.replace(line, bitrate=500_000)
    assert (sum_frame_bits(slow, GROUPS, is_fine=True), sample_age_ns(slow, GROUPS)) == (135, 1_000_000 + 270_000)


def test_a_coarse_step_near_0_is_half_a_millinewton_of_twenty() -> None:
    contract = Contract.from_layout(load_layout(Path("adaptive")))
    full_scale = contract.layout.taxels.force_max_n
    assert [coarse_value(code, False, contract.law) for code in (127, 128, 129)] == pytest.approx(
        [-full_scale / 40, 0.0, full_scale / 40], rel=1e-3
    )


@pytest.mark.parametrize(("offset_binary", "form"), [(False, 4), (True, 5)])
def test_encoding_tells_sums_of_an_analogue_front_end(offset_binary: bool, form: int) -> None:
    layout = load_layout(Path("analogue"))
    encoding = msgspec.structs.replace(layout.encoding, offset_binary=offset_binary)
    node = Contract.from_layout(msgspec.structs.replace(layout, encoding=encoding)).nodes[0]
    assert (node.encoding >> 16 & 0xFF, node.encoding & 0xFF, node.encoding >> 24) == (form, encoding.sum_bits, 1)
