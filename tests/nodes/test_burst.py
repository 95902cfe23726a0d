"""Bursts in every encoding: what the nodes pack, the collector reads, and remapped PDOs carry the same bits."""

from pathlib import Path

import msgspec
import numpy as np
import pytest
from canopen import SdoAbortedError

from dbc import indices as od
from dbc.canopen import SYNC_COB_ID
from dbc.contract import Contract, NodeContract
from dbc.dictionary import dictionary
from dbc.frame import CLASSIC_BYTES, ECHO, FD_BYTES
from gateway.batch import batch_of
from gateway.collector import Collector
from nodes.access import check_write
from nodes.burst import Burst
from nodes.objects import LocalNode, object_dictionary
from nodes.tpdo import read_tpdos
from skin.layout import Encoding, load_layout
from tests.bus.harness import frame
from tests.layouts import buses, small_layout

SUMS = np.random.default_rng(3).integers(-16368, 16369, 1024).astype(np.int32)


def made_of(name: str, **encoding: object) -> Contract:
    layout = small_layout(16, 16, bus=buses(4, 4)) if name == "small" else load_layout(Path(name))
    return Contract.from_layout(msgspec.structs.replace(layout, encoding=Encoding(**encoding)) if encoding else layout)


def local_of(contract: Contract, node: NodeContract) -> LocalNode:
    return LocalNode(node.node_id, object_dictionary(dictionary(contract, node)), contract.packing.bits, node.pdo_bytes)


def burst_of(contract: Contract, bus: int) -> Burst:
    nodes = contract.on_bus(bus)
    tpdos = [
        (place, node, tpdo)
        for place, node in enumerate(nodes)
        for tpdo in read_tpdos(local_of(contract, node), [each.number for each in node.tpdos])
    ]
    assert all(tpdo.is_plain for _, _, tpdo in tpdos)
    return Burst(contract, tpdos)


CASES = [
    ("small", {}),
    ("small", {"sum_bits": 16, "offset_binary": True}),
    *(("small", {"sum_bits": bits}) for bits in range(7, 14)),
    ("fd", {}),
    ("fd", {"sum_bits": 12}),
    ("fd", {"sum_bits": 7, "offset_binary": True}),
    ("one-bus-12bit", {}),
]


@pytest.mark.parametrize(("name", "encoding"), CASES)
def test_what_nodes_pack_the_collector_reads(name: str, encoding: dict[str, object]) -> None:
    contract = made_of(name, **encoding)
    collector = Collector(contract)
    collector.trust(slice(None), proven=True)
    bursts = [burst_of(contract, bus) for bus in range(len(contract.layout.bus))]
    sums = SUMS[: contract.phi.shape[0]]
    for counter in (1, 2):
        collector.open(counter)
        for bus, each in enumerate(bursts):
            burst = each.frames(counter, sums, np.ones(len(contract.on_bus(bus)), np.bool_))
            planned = contract.cycle(bus)[1:]
            by_id = burst[np.argsort(burst["can_id"])]
            for key in ("can_id", "length", "flags"):
                assert np.array_equal(by_id[key], planned[key])
            sync = frame(SYNC_COB_ID, bytes((counter,)), ECHO)
            collector.take(batch_of(np.concatenate((sync, burst)), bus, contract.table), 0)
        gathered = collector.close(counter)
        assert gathered.complete
        assert np.array_equal(gathered.sums, contract.packing.counts(contract.packing.raw(sums)))
    assert collector.counts.foreign == collector.counts.malformed == 0


@pytest.mark.parametrize("name", ["fd", "one-bus-12bit"])
def test_lost_frame_spoils_the_blocks_in_it_and_no_other(name: str) -> None:
    contract = made_of(name)
    burst = burst_of(contract, 0).frames(1, SUMS, np.ones(len(contract.nodes), np.bool_))
    collector = Collector(contract)
    collector.trust(slice(None), proven=True)
    collector.open(1)
    sync = frame(SYNC_COB_ID, b"\1", ECHO)
    collector.take(batch_of(np.concatenate((sync, np.delete(burst, 5))), 0, contract.table), 0)
    gathered = collector.close(1)
    there = contract.table.gather[contract.table.row_of[0, burst["can_id"][5]]]
    lost = np.unique(contract.phi.block_of_sum[there[there >= 0]])
    assert np.array_equal(np.flatnonzero(~gathered.valid), lost)
    whole = contract.phi.sums_of_blocks(gathered.valid)
    assert not gathered.sums[~whole].any()
    assert np.array_equal(gathered.sums[whole], contract.packing.counts(contract.packing.raw(SUMS[whole])))
    assert len(lost) == (4 if name == "fd" else 1)


@pytest.mark.parametrize(("name", "limit"), [("default", CLASSIC_BYTES), ("fd", FD_BYTES)])
def test_mapping_may_fill_a_frame_and_no_more(name: str, limit: int) -> None:
    contract = made_of(name)
    local = local_of(contract, contract.nodes[0])
    local.set_data(od.TPDO_COMMUNICATION, 1, (0x8000_0181).to_bytes(4, "little"))
    local.set_data(od.TPDO_MAPPING, 0, b"\0")
    bits = contract.packing.bits
    check_write(local, od.TPDO_MAPPING, 1, od.SUMS << 16 | 1 << 8 | bits)
    for width in (8, bits - 1, bits + 1, 32):
        with pytest.raises(SdoAbortedError):
            check_write(local, od.TPDO_MAPPING, 1, od.SUMS << 16 | 1 << 8 | width)
    most = 8 * limit // bits
    for place in range(1, most + 2):
        local.set_data(od.TPDO_MAPPING, place, (od.SUMS << 16 | 1 << 8 | bits).to_bytes(4, "little"))
    check_write(local, od.TPDO_MAPPING, 0, most)
    for count in (most + 1, limit + 1):
        with pytest.raises(SdoAbortedError):
            check_write(local, od.TPDO_MAPPING, 0, count)
