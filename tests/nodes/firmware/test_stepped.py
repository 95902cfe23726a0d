"""Stepped boards in C send what the Python nodes send, bit for bit, whatever is touched or lost."""

import os
import struct

import numpy as np
import pytest

from dbc import indices as od
from dbc.configuration import setting_of
from dbc.contract import Contract
from dbc.dictionary import dictionary
from skin.defects import parse_defects
from tests.nodes.firmware.stepped_twins import SKINS, SteppedTwins, contract_of
from tests.nodes.firmware.twins import needs_compiler

pytestmark = needs_compiler

#: Samples of every taxel that are compared: a million on request.
SAMPLES = int(os.environ.get("SKIN_FIRMWARE_CYCLES", "2500"))
#: Something of everything: taxels that are stuck, dead, saturated, noisy, that drift, and that feel their neighbours.
DEFECTS = ("stuck=0.05", "dead=0.05", "saturated=0.05", "noisy=0.05", "drift=0.0005", "cross-talk=0.1")
START, STOP, RESET_NODE, RESET_COMMUNICATION = 1, 2, 129, 130


@pytest.fixture(scope="module", params=SKINS)
def contract(request: pytest.FixtureRequest) -> Contract:
    return contract_of(request.param)


def run(twins: SteppedTwins, samples: int) -> int:
    """Go on with a SYNC every 100 ms; return how many frames were sent."""
    sent = 0
    for turn in range(samples // 100):
        twins.sync(turn % 240 + 1)
        sent += twins.run(100)
    return sent


@pytest.mark.heavy
def test_frames_of_touches_though_some_are_lost(contract: Contract) -> None:
    twins = SteppedTwins(contract, defects=parse_defects(DEFECTS, [], 3, contract.layout))
    twins.nmt(START)
    assert run(twins, SAMPLES) > SAMPLES / 20
    assert [segment.frames_sent for segment in twins.segments] == [twins.segments[0].frames_sent] * 2
    assert twins.segments[0].frames_sent > SAMPLES / 20


@pytest.mark.heavy
def test_a_full_transmit_queue(contract: Contract) -> None:
    twins = SteppedTwins(contract)
    twins.nmt(START)
    for room in (0, 1, 1 << 30):
        for link in twins.links:
            link.room = room
        run(twins, SAMPLES // 3)
    for node_id in twins.ids:
        assert any(twins.read(0x2020, 3, node_id))
    assert [segment.frames_dropped for segment in twins.segments] == [twins.segments[0].frames_dropped] * 2


@pytest.mark.heavy
def test_writes_of_all_settings(contract: Contract) -> None:
    twins = SteppedTwins(contract)
    random = np.random.default_rng(2)
    twins.nmt(START)
    objects = [each for each in dictionary(contract, contract.on_bus(0)[0]) if each.access == "rw"]
    objects = [each for each in objects if each.index >= 0x2000]
    last = objects[-70:]
    values = [
        *(struct.pack("<f", value) for value in (0.0, -0.0, 1.3e-4, 0.7, 3.0, -1.0, np.inf, np.nan, 1e-40)),
        *(struct.pack("<I", value) for value in (0, 1, 2, 40, 3000, 1 << 31)),
        *(bytes((value,)) for value in (0, 1, 3, 20, 240, 241)),
        b"\x05\x00",
    ]
    sent = 0
    for turn in range(150):
        each = objects[random.integers(len(objects))] if turn % 3 else last[turn % len(last)]
        size = len(setting_of(each).data)
        data = values[random.integers(len(values))]
        if random.random() < 0.8:
            data = data[:size].ljust(size, b"\0")
        twins.write(each.index, each.subindex or 0, data, int(random.integers(1, len(twins.ids) + 1)))
        if turn % 10 == 0:
            twins.sync(turn % 240 + 1)
        if turn % 40 == 39:
            twins.nmt((RESET_NODE, RESET_COMMUNICATION, STOP)[turn // 40 % 3], 1 + turn % 3)
            twins.run(3)
            twins.nmt(START)
        sent += twins.run(int(random.integers(1, 12)))
    assert sent > 50


@pytest.mark.heavy
def test_slots_and_what_boards_leave_out(contract: Contract) -> None:
    """Each node has its way of sending; a bus of two nodes has the first two. SYNCs come early, late, not at all."""
    twins = SteppedTwins(contract)
    ways = (0.0, 20, 0), (3.0, 7, 2500), (0.01, 100, 700)
    for node_id, (quiet, slots, offset_us) in zip(sorted(twins.ids), ways, strict=False):
        twins.write(od.SENDING, 1, struct.pack("<f", quiet), node_id)
        twins.write(od.SENDING, 2, bytes((slots,)), node_id)
        twins.write(od.SENDING, 3, struct.pack("<I", offset_us), node_id)
    twins.nmt(START)
    sent = 0
    for turn, milliseconds in enumerate((100, 99, 101, 60, 100, 250, 100, 3, 100, 100, 140)):
        twins.sync((236 + turn) % 240 + 1)
        sent += twins.run(milliseconds)
    assert sent > 100


@pytest.mark.heavy
def test_objects_that_boards_compute(contract: Contract) -> None:
    twins = SteppedTwins(contract)
    twins.nmt(START)
    seen = set()
    of_taxels = (od.COEFFICIENT_NOISE, od.TAXEL_NOISE, od.SUMS, od.COUNTS)
    for turn in range(6):
        run(twins, 200)
        twins.write(od.REFRESH, 0, bytes((turn % 2,)))
        words = len(contract.nodes[0].forms)
        for index, count in (*((index, contract.phi.block_size) for index in of_taxels), (od.WORDS, words)):
            for sub in range(count + 1):
                seen.add((index, sub, twins.read(index, sub)))
        for index in (od.SYNC_COUNTER, od.REFRESH, od.NODE_NOISE, od.SIGNATURE):
            seen.add((index, 0, twins.read(index)))
        seen |= {(od.SENDING, sub, twins.read(od.SENDING, sub)) for sub in range(4)}
        seen |= {(od.HEALTH, sub, twins.read(od.HEALTH, sub)) for sub in range(1, 5)}
    for told, least in ((od.SUMS, contract.phi.block_size), (od.COUNTS, contract.phi.block_size), (od.WORDS, 5)):
        assert len({value for index, _, value in seen if index == told}) > least
    assert {value[0] for index, _, value in seen if index == od.REFRESH} == {0, 1}
