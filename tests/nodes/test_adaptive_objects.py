"""The objects of an adaptive node: how it sends, what it has learned, what it would send."""

import struct
from pathlib import Path

import msgspec
import numpy as np
import pytest

from dbc.adaptive import FIRST_COB_ID, GROUP_SUMS
from dbc.contract import Contract
from gateway.adaptive_state import MALFORMED, UNREFINED, USED, new_sums
from skin.defects import Defects
from skin.layout import load_layout
from skin.zero_drift import ZeroDrift
from tests.bus.harness import frame
from tests.layouts import GROUPS, NODES
from tests.nodes.adaptive_bus import Bus, meanings, receive
from tests.nodes.helpers import RESET_NODE, START

LOAD = 0x6461_6F6C


@pytest.fixture(scope="module")
def contract() -> Contract:
    return Contract.from_layout(load_layout(Path("adaptive")))


def test_groups_that_are_asked_for_are_sent_again(bus: Bus) -> None:
    bus.start()
    bus.run(5)
    assert bus.write(0x2030, 0, b"\x05", 2) == 0
    assert bus.read(0x2030, 0, 2) == b"\x05"
    assert sorted(meanings(bus.run(3))) == [(2, 0, 0, False), (2, 0, 2, False)]
    assert bus.read(0x2030, 0, 2) == b"\0"
    assert bus.write(0x2030, 0, b"\x10", 2) == 0x0609_0030


def test_a_temperature_is_read_where_the_layout_has_thermometers(bus: Bus, contract: Contract) -> None:
    assert bus.sdo(1, struct.pack("<BHB", 0x40, 0x2036, 0)) == b"\x80\x36\x20\0" + struct.pack("<I", 0x0602_0000)
    layout = contract.layout
    taxels = msgspec.structs.replace(layout.taxels, has_thermometers=True)
    drift = ZeroDrift("cells", "ramp", 0.005, 1.0, 1.0, cells=tuple(contract.phi.taxels_of_blocks[1].tolist()))
    warm = Contract.from_layout(msgspec.structs.replace(layout, taxels=taxels))
    drifting = Bus(warm, defects=Defects(zero_drifts=(drift,)))
    drifting.start()
    drifting.sync()
    for after_ms, second_k in ((1, 298.2), (1500, 303.2), (600, 308.2)):
        drifting.run(after_ms)
        assert int.from_bytes(drifting.read(0x2036, 0, 2), "little") / 10 == pytest.approx(second_k, abs=0.11)
        assert drifting.read(0x2036) in {b"\xa5\x0b", b"\xa6\x0b"}
    assert drifting.write(0x2036, 0, b"\0\0") == 0x0601_0002


def test_a_tpdo_that_does_not_exist_is_not_sent_and_one_elsewhere_is(bus: Bus, contract: Contract) -> None:
    coarse = [tpdo for tpdo in contract.nodes[0].adaptive_tpdos if (tpdo.level, tpdo.is_fine) == (0, False)]
    off, moved = (0x1800 + tpdo.number - 1 for tpdo in coarse[:2])
    assert bus.write(off, 1, struct.pack("<I", 0xC000_0000 | coarse[0].cob_id)) == 0
    assert bus.write(moved, 1, struct.pack("<I", 0xC000_0000 | coarse[1].cob_id)) == 0
    assert bus.write(moved, 1, struct.pack("<I", 0x4000_06D0)) == 0
    bus.start()
    identifiers = set()
    for _ in range(3):
        bus.now_s += 1e-3
        bus.segment.tick(bus.now_s)
        sent = bus.link.take_sent()
        identifiers |= set(sent["can_id"][sent["port"] == 1].tolist())
        bus.segment.take(bus.link.receive(), bus.now_s)
    assert identifiers == {0x6D0, coarse[2].cob_id, coarse[3].cob_id}
    assert bus.boards.groups.check[0].tolist()[1] >= 0  # its echo was known
    # The mapping, and when a TPDO is sent, are fixed.
    assert bus.write(0x1A00, 0, b"\0") == 0x0601_0002
    assert bus.write(0x1800, 2, b"\1") == 0x0601_0002


def test_inhibit_time_of_a_tpdo_is_kept(bus: Bus, contract: Contract) -> None:
    for tpdo in contract.nodes[0].adaptive_tpdos:
        record = 0x1800 + tpdo.number - 1
        assert bus.write(record, 1, struct.pack("<I", 0xC000_0000 | tpdo.cob_id)) == 0
        assert bus.write(record, 3, struct.pack("<H", 200)) == 0  # 20 ms
        assert bus.write(record, 1, struct.pack("<I", 0x4000_0000 | tpdo.cob_id)) == 0
    bus.start()
    bus.sync()
    last: dict[int, int] = {}
    seen = 0
    for tick in range(400):
        for one in bus.run(1):
            if one["port"] == 1:
                can_id = int(one["can_id"])
                assert tick - last.get(can_id, -99) >= 20
                last[can_id], seen = tick, seen + 1
    assert seen > 10


def test_the_rule_of_one_node_is_changed_by_its_objects(bus: Bus) -> None:
    assert bus.write(0x2031, 9, struct.pack("<I", 0)) == 0x0609_0030
    assert bus.write(0x2031, 1, struct.pack("<f", float("nan"))) == 0x0609_0030
    assert bus.write(0x2031, 9, struct.pack("<I", 10), 2) == 0  # refresh after 10 ms
    bus.start()
    bus.run(2)
    assert {node for node, *_ in meanings(bus.run(20))} == {2}
    # More noise for a threshold: what is pressed is no news.
    assert bus.write(0x2031, 1, struct.pack("<f", 1e6), 3) == 0
    bus.sync()
    sent = meanings(bus.run(130))
    assert {node for node, level, *_ in sent if level > 1} == {1, 2, 4}
    bus.give(frame(0, bytes((RESET_NODE, 3))), frame(0, bytes((START, 3))))
    assert 3 in {node for node, level, *_ in meanings(bus.run(5)) if level > 1}


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


def test_codes_are_those_that_frames_carry(bus: Bus) -> None:
    bus.start()
    bus.sync()
    bus.run(400)
    law, known_n = bus.contract.law, bus.boards.groups.known_n[0]
    coarse = [int(bus.read(0x2110, place)[0]) for place in range(1, 33)]
    fine = [bus.read(0x2111, group + 1) for group in range(GROUPS)]
    mine = new_sums(1, GROUPS)
    for group in range(GROUPS):
        for number, payload in ((group, bytes(coarse[GROUP_SUMS * group :][:GROUP_SUMS])), (28 + group, fine[group])):
            receive(frame(FIRST_COB_ID + NODES * number, payload.ljust(8, b"\0")), law, mine)
    held = mine.value_n[0]
    refined = mine.counts[UNREFINED] == 0
    assert np.abs(held - known_n).max() <= 2 * law.fine_n if refined else True
    assert mine.counts[MALFORMED] == 0
    assert mine.counts[[USED, UNREFINED]].sum() == 2 * GROUPS


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
    assert bus.write(0x2034, 0, struct.pack("<I", 4000)) == 0
    assert bus.write(0x2030, 0, b"\x0f") == 0
    assert bus.write(0x1010, 1, b"save") == 0
    bus.give(frame(0, bytes((RESET_NODE, 1))))
    assert int.from_bytes(bus.read(0x2034), "little") == 4000
    assert bus.boards.controllers.budget[0] == 4000
    assert bus.read(0x2030) == b"\0"
    assert bus.write(0x1011, 1, struct.pack("<I", LOAD)) == 0
    bus.give(frame(0, bytes((RESET_NODE, 1))))
    assert bus.boards.controllers.budget[0] == 0


def test_gains_change_what_a_node_feels_and_not_its_noise(bus: Bus) -> None:
    bus.start()
    bus.sync()
    bus.run(600)
    mine = slice(32 * bus.contract.nodes[0].block, 32 * bus.contract.nodes[0].block + 32)
    felt = bus.boards.sums[mine].copy()
    learned = [bus.read_real(index, 5) for index in (0x2032, 0x2033)]
    for taxel in range(1, 33):
        assert bus.write(0x2010, taxel, struct.pack("<f", 0.5)) == 0
    assert [bus.read_real(index, 5) for index in (0x2032, 0x2033)] == learned
    bus.run(600)
    assert bus.boards.sums[mine] == pytest.approx(felt / 2, abs=0.02 * np.abs(felt).max())
