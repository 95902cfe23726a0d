"""The gateway reads the temperatures of all boards in turn, beside their sums."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.calibrator import Calibrator
from dbc import indices as od
from dbc.canopen import SDO_REQUEST_BASE
from gateway.calibration import GatewayCalibration
from gateway.temperatures import PERIOD_S
from skin.defects import Defects
from skin.zero_drift import DRIFT_N_PER_K, REST_K, ZeroDrift
from tests.gateway.boards import BoardWorld, small_stepped
from tests.layouts import buses, small_contract
from tests.world import World

READ = b"\x40" + od.TEMPERATURE.to_bytes(2, "little")


class Warm:
    """A gateway with a calibration that keeps every temperature that came."""

    def __init__(self, world: World | BoardWorld, monkeypatch: pytest.MonkeyPatch) -> None:
        self.world = world
        self.calibration = GatewayCalibration(world.contract, tares=False)
        self.taken: list[np.ndarray] = []
        monkeypatch.setattr(Calibrator, "take_temperatures", lambda _, kelvin: self.taken.append(kelvin))

    def run(self, seconds: float) -> np.ndarray:
        until_s = self.world.now_s + seconds
        while self.world.now_s < until_s:
            self.world.step()
            self.calibration.tick(self.world.gateway.masters, self.world.now_s)
        return self.taken[-1]


@pytest.mark.parametrize("blocks_per_node", [1, 2])
def test_temperatures_follow_the_drift_of_each_board(blocks_per_node: int, monkeypatch: pytest.MonkeyPatch) -> None:
    bus = buses(*2 * [2 // blocks_per_node], blocks_per_node=blocks_per_node)
    world = World(small_contract(bus=bus, taxels={"has_thermometers": True}))
    world.until_whole(2.0)
    warm = Warm(world, monkeypatch)
    assert warm.run(2 * PERIOD_S) == pytest.approx(REST_K, abs=0.051)
    cells = tuple(world.contract.phi.taxels_of_blocks[3].tolist())
    drift = ZeroDrift("cells", "step", 10 * DRIFT_N_PER_K, cells=cells)
    world.electronics._model = replace(world.electronics._model, defects=Defects(zero_drifts=(drift,)))
    expected = REST_K + np.repeat(np.array([0, 0, 0, 10.0]).reshape(-1, blocks_per_node).mean(axis=1), blocks_per_node)
    assert warm.run(2 * PERIOD_S) == pytest.approx(expected, abs=0.051)
    assert world.measured[-1].valid == b"\1" * 4
    asked = [can_id for can_id, data in world.wires[1].log if data[:3] == READ]
    assert asked.count(SDO_REQUEST_BASE + 1) in {3, 4, 5}


def test_a_board_that_is_not_in_use_or_knows_none_has_no_temperature(monkeypatch: pytest.MonkeyPatch) -> None:
    contract = small_stepped(taxels={"has_thermometers": True})
    world = BoardWorld(contract)
    for board, data in zip(world.boards, (b"\xff\x7f", b"\xa6\x0b", None, b"\0\0"), strict=True):
        if data is not None:
            board.objects[od.TEMPERATURE, 0] = data
    world.until_whole(1.0)
    warm = Warm(world, monkeypatch)
    assert warm.run(PERIOD_S + 0.5) == pytest.approx([np.nan, 298.2, np.nan, np.nan], nan_ok=True)
    world.boards[1].answers = world.boards[1].beats = world.boards[1].speaks = False
    assert np.isnan(warm.run(2 * PERIOD_S)).all()


def test_without_thermometers_nobody_is_asked(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    warm = Warm(world, monkeypatch)
    warm.taken.append(np.zeros(0))
    assert warm.run(1.0).size == 0
    assert not [data for wire in world.wires for _, data in wire.log if data[:3] == READ]
