"""TIME is sent on request, after a SYNC, and disturbs no cycle."""

import msgspec
import numpy as np
import pytest

from dbc.canopen import SYNC_COB_ID, TIME_COB_ID
from dbc.contract import Contract
from dbc.frame import Frames
from dbc.time_of_day import time_of_day
from gateway.loop import GatewayLoop
from tests.world import PERIOD_S, World, valid


def timed(contract: Contract, time_s: float | None) -> World:
    layout = contract.layout
    sync = msgspec.structs.replace(layout.sync, time_s=time_s)
    world = World(Contract.from_layout(msgspec.structs.replace(layout, sync=sync)))
    world.until_whole(2.0)
    return world


@pytest.mark.parametrize(("periods", "nearest"), [(3.2, 3), (3.6, 4)])
def test_time_follows_a_sync_on_every_bus_at_its_period(small: Contract, periods: float, nearest: int) -> None:
    world = timed(small, periods * PERIOD_S)
    for wire in world.wires:
        wire.log.clear()
    came = world.run(30 * PERIOD_S)
    assert all(valid(each).all() and not world.wrong_blocks(each) for each in came)
    for wire in world.wires:
        ids = [can_id for can_id, _ in wire.log]
        times = [place for place, can_id in enumerate(ids) if can_id == TIME_COB_ID]
        assert all(ids[place - 1] == SYNC_COB_ID for place in times)
        syncs = np.cumsum([can_id == SYNC_COB_ID for can_id in ids])
        assert set(np.diff(syncs[times]).tolist()) == {nearest}
        assert len(times) == pytest.approx(30 / nearest, abs=1)


def test_no_time_without_the_key(small: Contract) -> None:
    world = timed(small, None)
    assert all(can_id != TIME_COB_ID for wire in world.wires for can_id, _ in wire.log)


def test_time_is_the_wall_clock(small: Contract) -> None:
    sent = []
    layout = msgspec.structs.replace(small.layout, sync=msgspec.structs.replace(small.layout.sync, time_s=1.0))
    sends = dict.fromkeys(range(len(layout.bus)), lambda burst: sent.append(burst.copy()) or len(burst))
    loop = GatewayLoop(Contract.from_layout(layout), sends, 5.0, say=str, complain=str)
    loop.sync.start(7.0)
    loop.send_sync(7.001, 1_750_000_000_000_000_000)
    (found,) = {each["data"][0, :6].tobytes() for each in sent if each["can_id"][0] == TIME_COB_ID}
    assert found == time_of_day(1_750_000_007_001_000_000)


def test_the_first_sync_may_have_its_time_at_once(small: Contract) -> None:
    sent: list[int] = []

    def send(burst: Frames) -> int:
        sent.append(int(burst["can_id"][0]))
        return len(burst)

    layout = msgspec.structs.replace(small.layout, sync=msgspec.structs.replace(small.layout.sync, time_s=1.0))
    loop = GatewayLoop(Contract.from_layout(layout), {0: send, 1: send}, 5.0, say=print, complain=print)
    loop.sync.start(5.0)
    loop.send_sync(5.0)
    assert sent == [SYNC_COB_ID] * 2 + [TIME_COB_ID] * 2
