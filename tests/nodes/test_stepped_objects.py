"""The objects of a stepped node: how it sends, what it has learned, what it would send."""

import struct
from pathlib import Path

import msgspec
import numpy as np
import pytest

from dbc.contract import Contract
from dbc.steps import SET
from skin.defects import Defects
from skin.layout import load_layout
from skin.zero_drift import ZeroDrift
from tests.bus.harness import frame
from tests.nodes.helpers import RESET_NODE
from tests.nodes.stepped_bus import SET_MS, SLOT_MS, Bus

LOAD = 0x6461_6F6C


@pytest.fixture(scope="module")
def contract() -> Contract:
    return Contract.from_layout(load_layout(Path("steps")))


def test_a_node_that_is_asked_sets_all_its_sums(bus: Bus) -> None:
    bus.begin()
    bus.run(SET_MS)
    assert bus.write(0x2030, 0, b"\x01", 2) == 0
    assert bus.read(0x2030, 0, 2) == b"\1"
    assert bus.read(0x2030, 0, 1) == b"\0"
    (part,) = bus.parts_of(bus.blocks[1])
    part.kinds = []
    sent = bus.run(SET_MS)
    assert part.kinds[:11] == [SET] * 11
    assert sent["port"].tolist().count(2) >= 11
    assert bus.read(0x2030, 0, 2) == b"\0"
    assert bus.write(0x2030, 0, b"\x02", 2) == 0x0609_0030
    assert bus.write(0x2030, 0, b"\x00", 2) == 0


def test_a_temperature_is_read_where_the_layout_has_thermometers(bus: Bus, contract: Contract) -> None:
    assert bus.sdo(1, struct.pack("<BHB", 0x40, 0x2036, 0)) == b"\x80\x36\x20\0" + struct.pack("<I", 0x0602_0000)
    layout = contract.layout
    taxels = msgspec.structs.replace(layout.taxels, has_thermometers=True)
    drift = ZeroDrift("cells", "ramp", 0.005, 1.0, 1.0, cells=tuple(contract.phi.taxels_of_blocks[1].tolist()))
    warm = Contract.from_layout(msgspec.structs.replace(layout, taxels=taxels))
    drifting = Bus(warm, defects=Defects(zero_drifts=(drift,)))
    drifting.begin()
    for after_ms, second_k in ((1, 298.2), (1500, 303.2), (600, 308.2)):
        drifting.run(after_ms)
        assert int.from_bytes(drifting.read(0x2036, 0, 2), "little") / 10 == pytest.approx(second_k, abs=0.11)
        assert drifting.read(0x2036) in {b"\xa5\x0b", b"\xa6\x0b"}
    assert drifting.write(0x2036, 0, b"\0\0") == 0x0601_0002


def test_a_tpdo_that_does_not_exist_is_not_sent_and_one_elsewhere_is(bus: Bus) -> None:
    for node_id in (1, 2):
        assert bus.write(0x1800, 1, struct.pack("<I", 0xC000_0180 | node_id), node_id) == 0
    assert bus.write(0x1800, 1, struct.pack("<I", 0x4000_06D0), 2) == 0
    bus.begin()
    sent = []
    for _ in range(20):
        bus.segment.take(bus.link.receive(), bus.now_s)
        bus.now_s += 1e-3
        bus.segment.tick(bus.now_s)
        sent += bus.link.take_sent()["can_id"].tolist()
    assert set(sent) - {0x701, 0x702, 0x703, 0x704} == {0x6D0, 0x183, 0x184}
    assert sent.count(0x6D0) > 1  # its echo was known
    # The mapping, and when a TPDO is sent, are fixed.
    assert bus.write(0x1A00, 0, b"\0") == 0x0601_0002
    for place in (2, 3, 5, 6):
        assert bus.write(0x1800, place, b"\1") == 0x0601_0002


def test_when_one_node_sends_is_changed_by_its_objects(bus: Bus) -> None:
    for place, value in ((1, float("nan")), (1, -1.0), (1, float("inf"))):
        assert bus.write(0x2031, place, struct.pack("<f", value)) == 0x0609_0030
    for slots in (b"\0", b"\xf1"):
        assert bus.write(0x2031, 2, slots) == 0x0609_0030
    assert bus.read_real(0x2031, 1) == np.float32(0.1)
    assert bus.write(0x2031, 1, struct.pack("<f", 0)) == 0  # in every slot
    assert bus.write(0x2031, 1, struct.pack("<f", 1e6), 2) == 0  # nothing is worth its bits
    assert bus.write(0x2031, 2, b"\x0a", 3) == 0  # every 10 ms
    assert bus.write(0x2031, 3, struct.pack("<I", 2000), 4) == 0
    bus.begin()
    sync_ns = round(bus.now_s * 1e9)
    sent = bus.run(299)
    ports = sent["port"].tolist()
    assert ports.count(1) == 300 / SLOT_MS
    assert ports.count(2) == 12  # all groups, and a check
    assert ports.count(3) <= 30
    late_ms = (sent["time_ns"][sent["port"] == 4] - sync_ns) / 1e6 % SLOT_MS
    assert 2 - 1e-6 <= late_ms.min() <= late_ms.max() < 3 + 1e-6
    bus.give(frame(0, bytes((RESET_NODE, 1))))
    assert bus.read_real(0x2031, 1) == np.float32(0.1)
    assert bus.boards.senders.slots.quiet[bus.blocks[0]] == np.float32(0.1)


def test_noise_that_is_written_takes_the_place_of_what_was_learned(bus: Bus) -> None:
    learned = bus.read_real(0x2032, 7)
    assert bus.read_real(0x2035) == pytest.approx(learned)
    for place in range(1, 33):
        assert bus.write(0x2032, place, struct.pack("<f", 1e-3)) == 0
        assert bus.write(0x2033, place, struct.pack("<f", 2e-3)) == 0
    bus.run(300)
    assert bus.read_real(0x2035) == pytest.approx(1e-3)
    assert bus.read_real(0x2033, 32) == pytest.approx(2e-3)
    assert bus.read_real(0x2035, node_id=2) == pytest.approx(learned)
    for place in range(1, 33):
        assert bus.write(0x2032, place, struct.pack("<f", 0)) == 0
    assert bus.read_real(0x2035) == pytest.approx(learned)
    assert bus.read_real(0x2033, 1) == pytest.approx(2e-3)
    assert bus.write(0x2032, 1, struct.pack("<f", -1)) == 0x0609_0030


@pytest.mark.parametrize("name", ["steps", "steps-fd"])
def test_slot_and_words_are_those_of_the_newest_frame(name: str) -> None:
    bus = Bus(Contract.from_layout(load_layout(Path(name))))
    assert bus.read(0x2022) == b"\0"
    bus.begin()
    sent = bus.run(103)
    newest = sent[sent["port"] == 1][-1]["data"]
    assert bus.read(0x2022) == bytes(newest[:1])
    for place in range(len(bus.contract.forms_of(0))):
        assert bus.read(0x2110, place + 1) == bytes(newest[1 + 7 * place : 8 + 7 * place])


def test_test_patterns_and_corrections_show_in_the_sums(bus: Bus) -> None:
    bus.run(300)
    assert bus.write(0x2021, 0, b"\3") == 0
    bus.run(50)
    full_n = 32 * 0.02
    shown = np.frombuffer(bus.boards.sums.astype("<i4").tobytes(), "<i4")[: bus.contract.phi.block_size]
    assert shown[0] * bus.contract.layout.taxels.newton_per_count == pytest.approx(full_n, rel=0.01)
    assert int.from_bytes(bus.read(0x2020, 4), "little") == 32
    bus.give(frame(0, bytes((RESET_NODE, 1))))
    bus.run(300)
    assert int.from_bytes(bus.read(0x2020, 4), "little") == 0


def test_parameters_are_stored_and_orders_are_not(tmp_path: Path, contract: Contract) -> None:
    bus = Bus(contract)
    assert bus.write(0x2031, 3, struct.pack("<I", 4000)) == 0
    assert bus.write(0x2030, 0, b"\x01") == 0
    assert bus.write(0x1010, 1, b"save") == 0
    bus.give(frame(0, bytes((RESET_NODE, 1))))
    assert int.from_bytes(bus.read(0x2031, 3), "little") == 4000
    assert bus.boards.senders.slots.offset_ns[bus.blocks[0]] == 4_000_000
    assert bus.write(0x1011, 1, struct.pack("<I", LOAD)) == 0
    bus.give(frame(0, bytes((RESET_NODE, 1))))
    assert bus.boards.senders.slots.offset_ns[bus.blocks[0]] == 0


def test_gains_change_what_a_node_feels_and_not_its_noise(bus: Bus) -> None:
    bus.begin()
    bus.run(600)
    mine = slice(32 * bus.contract.nodes[0].block, 32 * bus.contract.nodes[0].block + 32)
    felt = bus.boards.sums[mine].copy()
    learned = [bus.read_real(index, 5) for index in (0x2032, 0x2033)]
    for taxel in range(1, 33):
        assert bus.write(0x2010, taxel, struct.pack("<f", 0.5)) == 0
    assert [bus.read_real(index, 5) for index in (0x2032, 0x2033)] == learned
    bus.run(600)
    assert bus.boards.sums[mine] == pytest.approx(felt / 2, abs=0.02 * np.abs(felt).max())
