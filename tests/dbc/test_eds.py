"""The EDS and DCF files, read by two libraries that share no code: both find the dictionary of the node."""

import math
import warnings
from pathlib import Path
from typing import Any

import canopen
import msgspec
import pytest
from canopen.objectdictionary import ODVariable
from dcf.device import Device

from dbc import indices as od
from dbc.configuration import configuration
from dbc.contract import Contract, NodeContract
from dbc.dictionary import dictionary
from dbc.eds import NO_BLOCK, NodeType, dcfs, eds, node_name, node_types
from dbc.objects import Object
from skin.layout import Layout, load_layout
from tests.layouts import buses, in_turns, small_layout

MIXED = small_layout(
    16,
    16,
    taxels={"has_thermometers": True},
    measurement={"selection": "uniform", "seed": 3},
    encoding={"sum_bits": 12},
    bus=[{"name": "a", "nodes": 2, "blocks_per_node": 2}, {"name": "b", "nodes": 4, "fd": True}],
)
#: Serial number, and what a node measures: the values in which nodes of a type differ.
DIFFERING = {od.IDENTITY, od.BLOCK, od.ROWS, od.TAXELS}
SHIPPED = "default", "fd", "one-bus-12bit", "recognition"
LAYOUTS: dict[str, Layout] = {name: load_layout(Path(name)) for name in SHIPPED}
LAYOUTS["in turns"] = in_turns(load_layout())
LAYOUTS["mixed"] = MIXED


def written(contract: Contract, kind: NodeType, folder: Path) -> str:
    path = folder / kind.file
    path.write_text(eds(contract, kind), "ascii")
    return str(path)


def some(kind: NodeType) -> list[NodeContract]:
    return [kind.nodes[0], *kind.nodes[1:][-1:]]


def some_types(contract: Contract) -> list[NodeType]:
    """Return three of the types of nodes at most: of one layout all are written alike, and reading takes a second."""
    types = node_types(contract)
    return types if len(types) < 4 else [*types[:2], types[-1]]


@pytest.mark.heavy
@pytest.mark.parametrize("name", LAYOUTS)
def test_canopen_reads_the_dictionary(name: str, tmp_path: Path) -> None:
    contract = Contract.from_layout(LAYOUTS[name])
    for kind in some_types(contract):
        path = written(contract, kind, tmp_path)
        for node in some(kind):
            found = canopen.import_od(path, node.node_id)
            variables = {(each.index, each.subindex): each for each in flat(found)}
            objects = dictionary(contract, node)
            assert set(variables) == {(each.index, each.subindex or 0) for each in objects}
            for each in objects:
                same_object(each, variables[each.index, each.subindex or 0], alone=len(kind.nodes) == 1)


def flat(found: canopen.ObjectDictionary) -> list[ODVariable]:
    return [
        entry
        for each in found.values()
        for entry in ([each] if isinstance(each, ODVariable) else each.subindices.values())
    ]


def same_object(wanted: Object, got: ODVariable, *, alone: bool) -> None:
    assert (got.name, got.data_type, got.access_type, got.pdo_mappable) == (
        wanted.name,
        wanted.data_type,
        wanted.access,
        wanted.pdo,
    )
    is_mapped = od.TPDO_MAPPING <= wanted.index < od.TPDO_END
    is_own = (od.split_block(wanted.index)[1] in DIFFERING or is_mapped) and wanted.subindex != 0
    unset = NO_BLOCK if wanted.index == od.BLOCK else 0
    value = None if wanted.data_type == od.DOMAIN else wanted.value
    assert got.default == value or (is_own and not alone and got.default == unset)


@pytest.mark.heavy
@pytest.mark.parametrize("name", ["fd", "mixed"])
def test_the_dcf_of_a_node_has_its_own_values(name: str, tmp_path: Path) -> None:
    contract = Contract.from_layout(LAYOUTS[name])
    for kind in some_types(contract):
        for node, text in list(dcfs(contract, kind))[-2:]:
            path = tmp_path / f"{node_name(contract, node)}.dcf"
            path.write_text(text, "ascii")
            found = canopen.import_od(str(path))  # the node-ID is that of the file
            bus = contract.layout.bus[node.bus]
            assert (found.node_id, found.bitrate) == (node.node_id, bus.bitrate)
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                device = Device.from_dcf(str(path), {})
            assert (device.node_id, device.serial_number) == (node.node_id, node.block + 1)
            variables = {(each.index, each.subindex): each for each in flat(found)}
            # A tool that configures a device writes the ParameterValues alone.
            written = [each for each in configuration(contract, node) if each.is_writable]
            values = [variables[each.index, each.subindex].value for each in written]
            assert values == [int.from_bytes(each.data, "little") for each in written]
            for each in dictionary(contract, node):
                got = variables[each.index, each.subindex or 0]
                if each.data_type == od.DOMAIN:
                    continue
                assert (got.default if got.value is None else got.value) == each.value
                if each.data_type != od.VISIBLE_STRING:
                    assert device[each.index][each.subindex or 0].parse_value() == each.value


@pytest.mark.heavy
@pytest.mark.parametrize("name", ["default", "steps"])
def test_no_warning_of_any_reader_and_no_value_without_default(
    name: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    contract = Contract.from_layout(load_layout(Path(name)))
    (kind,) = node_types(contract)
    path = written(contract, kind, tmp_path)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Device.from_dcf(path, {"NODEID": 3})
    found = canopen.import_od(path, 3)
    assert not caplog.records
    assert f"-DOD_CNT_SDO_SRV=1 -DOD_CNT_TPDO={len(kind.nodes[0].tpdos)}" in found.comments
    unsaid = {each.index for each in flat(found) if each.default is None}
    # Programs, and fractions, on whose form readers disagree.
    assert unsaid == {od.PROGRAM_DATA} | ({od.UNIT, od.SENDING} if name == "steps" else set())


@pytest.mark.heavy
@pytest.mark.parametrize("name", LAYOUTS)
def test_lely_reads_the_dictionary_and_has_no_complaint(name: str, tmp_path: Path) -> None:
    contract = Contract.from_layout(LAYOUTS[name])
    for kind in some_types(contract):
        path = written(contract, kind, tmp_path)
        for node in some(kind):
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                device = Device.from_dcf(path, {"NODEID": node.node_id})
            objects = dictionary(contract, node)
            assert {(index, sub) for index, each in device.items() for sub in each} == {
                (each.index, each.subindex or 0) for each in objects
            }
            for each in objects:
                got = device[each.index][each.subindex or 0]
                assert (got.name, got.data_type.index, got.access_type.name) == (each.name, each.data_type, each.access)
                assert got.pdo_mapping == each.pdo
            for tpdo in node.tpdos:
                same_pdo(contract, node, tpdo, device.tpdo[tpdo.number])
            assert len(device.rpdo) == 0


def same_pdo(contract: Contract, node: NodeContract, tpdo: Any, got: Any) -> None:
    assert got.cob_id == 0x4000_0000 | tpdo.cob_id
    turn = (2, tpdo.turn + 1) if contract.turns > 1 else (1, 0)
    assert (got.transmission_type, got.sync_start_value, got.n) == (*turn, 1 + tpdo.sums)
    counter, *names = (entry.name for entry in got.mapping.values())
    assert counter == "SYNC counter of the sums"
    blocks = contract.phi.block_of_sum[tpdo.first_sum : tpdo.first_sum + tpdo.sums]
    starts = contract.phi.starts[blocks]
    assert names == [f"Sum {tpdo.first_sum + place - start + 1}" for place, start in enumerate(starts)]


@pytest.mark.parametrize("bits", range(7, 17))
def test_a_stock_stack_maps_the_counter_and_then_the_sums_of_any_width(bits: int, tmp_path: Path) -> None:
    """Names, places and lengths as canopen maps them from the DCF; Granularity is the unit of both lengths."""
    line = buses(1, fd=bits % 2 == 1, blocks_per_node=2)
    layout = in_turns(small_layout(encoding={"sum_bits": bits}, bus=line), 1 + bits % 2)
    contract = Contract.from_layout(layout)
    (kind,) = node_types(contract)
    ((node, text),) = dcfs(contract, kind)
    path = tmp_path / "node.dcf"
    path.write_text(text, "ascii")
    assert f"Granularity={math.gcd(bits, 8)}\n" in eds(contract, kind)
    found = canopen.import_od(str(path))
    wanted = [(od.of_block(od.SUMS, block), place) for block in (0, 1) for place in range(1, 9)]
    for tpdo in node.tpdos:
        communication, mapping = found[0x17FF + tpdo.number], found[0x19FF + tpdo.number]
        kind_and_start = (communication[2].value, communication[6].value)
        assert kind_and_start == ((2, tpdo.turn + 1) if contract.turns > 1 else (1, 0))
        counter, *sums = [mapping[place].value for place in range(1, mapping[0].value + 1)]
        assert counter == 0x2022_00_08
        assert [each & 0xFF for each in sums] == [bits] * tpdo.sums
        places = [(each >> 16, each >> 8 & 0xFF) for each in sums]
        assert places == wanted[tpdo.first_sum : tpdo.first_sum + tpdo.sums]
    assert found[0x2022].pdo_mappable
    assert (found[0x2022].data_type, found[0x2022].access_type) == (od.UNSIGNED8, "ro")


def test_nodes_that_differ_in_values_are_one_type() -> None:
    (kind,) = node_types(Contract.from_layout(LAYOUTS["default"]))
    assert (kind.file, len(kind.nodes)) == ("skin.eds", 128)


def test_every_node_has_one_type_and_each_number_of_sums_its_own() -> None:
    layout = LAYOUTS["default"]
    measurement = msgspec.structs.replace(layout.measurement, selection="uniform")
    contract = Contract.from_layout(msgspec.structs.replace(layout, measurement=measurement))
    kinds = node_types(contract)
    assert sorted(node.block for kind in kinds for node in kind.nodes) == list(range(128))
    assert len(kinds) == len({node.sums for node in contract.nodes}) > 5
    assert len({kind.file for kind in kinds}) == len(kinds)
    assert [kind.file for kind in kinds] == [f"skin-type{number}.eds" for number in range(1, len(kinds) + 1)]
