"""Boards in C before the real gateway, with all sums in each cycle and in turns."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from canskin.messages import Measurement
from dbc.canopen import NMT_COB_ID, SDO_REQUEST_BASE, SYNC_COB_ID, NmtCommand
from dbc.contract import Contract
from nodes.firmware.library import Firmware
from nodes.segment import Segment
from tests.layouts import TURNS
from tests.nodes.firmware.twins import CountWitness, needs_compiler, small_contract
from tests.world import PERIOD_S, World

pytestmark = needs_compiler


@dataclass
class FirmwareWorld(World):
    """The skin with boards in C."""

    witness: CountWitness = field(init=False)

    def __post_init__(self) -> None:
        self.witness = CountWitness(self.contract)
        self.firmware = Firmware(self.contract, self.contract.nodes)
        super().__post_init__()

    def new_segment(self, bus: int, contract: Contract) -> Segment:
        boards, send = self.firmware.boards(bus), self.wires[bus].nodes.send
        return Segment(contract, bus, boards, self.witness, send, complain=self.complaints.append)

    def wrong_blocks(self, measurement: Measurement) -> int:
        """Count the valid blocks whose sums are not those of the counts in the newest cycle of their turn."""
        contract, block_of_sum, table = self.contract, self.contract.phi.block_of_sum, self.contract.table
        is_valid = (np.frombuffer(measurement.valid, np.uint8) == 1)[block_of_sum]
        turn = np.zeros(len(block_of_sum), np.intp)
        for row, places in enumerate(table.gather):
            turn[places[places >= 0]] = table.turn[row]
        age = (contract.turn_of(measurement.sync_counter) - turn) % contract.turns
        right = np.zeros(len(block_of_sum), np.bool_)
        for cycles in np.unique(age[is_valid]).tolist():
            then_ns = measurement.sampled_mono_ns - round(cycles * contract.layout.sync.period_s * 1e9)
            sent = contract.packing.counts(contract.packing.raw(self.witness.sums_at(then_ns)))
            right |= (age == cycles) & (np.frombuffer(measurement.sums, "<i4") == sent)
        return int(np.unique(block_of_sum[is_valid & ~right]).size)


@pytest.fixture(params=TURNS)
def world(request: pytest.FixtureRequest) -> FirmwareWorld:
    return FirmwareWorld(small_contract(turns=request.param, rate_hz=1 / PERIOD_S))


def is_complete(measurement: Measurement) -> bool:
    return measurement.valid == b"\x01" * len(measurement.valid)


def test_boards_are_proven_started_and_measure(world: FirmwareWorld) -> None:
    measured = world.run(3.0)
    assert sum(map(is_complete, measured)) > 20
    assert all(map(is_complete, measured[-10:]))
    assert not sum(map(world.wrong_blocks, measured))
    assert not world.complaints


def test_lost_syncs_make_no_valid_block_wrong(world: FirmwareWorld) -> None:
    world.run(2.0)
    random = np.random.default_rng(7)
    for wire in world.wires:
        wire.loses = lambda end, frame: (
            end is not end.wire.gateway and frame["can_id"] == SYNC_COB_ID and random.random() < 0.2
        )
    measured = world.run(6.0)
    complete = sum(map(is_complete, measured))
    assert 0.2 * len(measured) < complete < 0.9 * len(measured)
    assert not sum(map(world.wrong_blocks, measured))
    for wire in world.wires:
        wire.loses = None
    assert all(map(is_complete, world.run(1.0)[-10:]))


def test_a_board_that_is_reset_or_shows_a_pattern_is_put_right(world: FirmwareWorld) -> None:
    world.run(2.0)
    for can_id, data in (
        (NMT_COB_ID, bytes((NmtCommand.RESET_NODE, 1))),
        (SDO_REQUEST_BASE + 2, bytes((0x2F, 0x21, 0x20, 0, 3, 0, 0, 0))),
    ):
        world.wires[0].put(can_id, data)
        measured = world.run(3.0)
        assert not all(map(is_complete, measured))
        assert all(map(is_complete, measured[-10:]))
        assert not sum(map(world.wrong_blocks, measured))
