"""A skin beside drives on one bus: neither disturbs the other, and each is known by name."""

import pytest

from bandwidth.plan import plan_bus
from bandwidth.traffic import Disturbance
from canskin.errors import LayoutError
from commissioning.scan import Scan
from dbc.canopen import SYNC_COB_ID
from tests.gateway.drives import DRIVES, OTHER_PRODUCER, THEIR_SYNC, Drives, SharedWorld, shared_contract
from tests.world import valid

SECONDS = 1.5


@pytest.mark.heavy
def test_frames_of_drives_end_within_the_plan_and_all_sums_are_exact() -> None:
    contract = shared_contract()
    plan = plan_bus(contract, 0, None, Disturbance().of(contract.layout))
    assert plan.problems == []
    bounds_ms = {each.identifier: each.response_ms for each in plan.foreign}
    world = SharedWorld(contract)
    drives = Drives(world.shared)
    commands = []
    world.shared.join(
        "listener", lambda arrived: commands.extend(arrived["data"][arrived["can_id"] == 0][:, :2].tolist())
    )
    world.until_whole(5.0)
    drives.send_for(world.now_s, SECONDS, seed=3)
    measured = world.run(SECONDS + 0.1)
    # Nothing of theirs is later than planned.
    worst_ms = drives.worst_ms()
    assert len(worst_ms) == 1 + 6 * len(DRIVES)
    assert {identifier for identifier, each_ms in worst_ms.items() if each_ms > (bounds_ms[identifier] or 0)} == set()
    assert max(worst_ms.values()) > 0.5  # the bus is shared: some frame has waited
    # Nothing of ours is wrong or missing, and no drive is commanded.
    assert len(measured) > 140
    assert all(valid(each).all() for each in measured)
    assert [world.wrong_blocks(each) for each in measured] == [[]] * len(measured)
    assert {node_id for _, node_id in commands} == set(range(33, 49))
    assert world.complaints == []


@pytest.mark.heavy
def test_a_second_sync_producer_is_named_with_what_to_do_and_its_cycles_are_not_valid() -> None:
    world = SharedWorld(shared_contract())
    drives = Drives(world.shared)
    world.until_whole(5.0)
    drives.send_for(world.now_s, 0.3, seed=1)
    world.run(0.3)
    for _ in range(60):
        counter = world.gateway.sync.counter % 240 + 1
        world.shared.put(SYNC_COB_ID, bytes((counter,)))
        world.run(0.01)
    named = f"another SYNC producer on can0: node {OTHER_PRODUCER} produces SYNC, which is the gateway's part"
    assert f"{named}: clear bit 30 of 1005h there [other-sync]" in world.lines
    assert not any(valid(each).any() for each in world.measured[-30:])
    assert not any(world.wrong_blocks(each) for each in world.measured)
    world.until_whole(1.0)


def test_two_sync_producers_are_refused_by_name() -> None:
    table = {"name": "motion.sync", "identifier": 0x80, "length": 0, "period_s": 0.004}
    with pytest.raises(
        LayoutError, match=r"two SYNC producers on can0, 'motion.sync' and the gateway.*bit 30 of 1005h"
    ):
        shared_contract(foreign=[table])


@pytest.mark.heavy
def test_a_scan_lists_drives_and_boards_with_identities_states_and_rates() -> None:
    world = SharedWorld(shared_contract())
    world.step_s = 0.002  # type: ignore[misc]
    drives = Drives(world.shared)
    scans: list[Scan] = []
    send = world.shared.join("scan", lambda arrived: [each.take(arrived, world.now_s) for each in scans])
    world.until_whole(5.0)
    drives.send_for(world.now_s, 2.0, seed=2)
    scans.append(Scan(send, 20_000_000, world.now_s, listen_s=0.5))  # a fast bus: more requests a second
    (scan,) = scans
    while not scan.done:
        world.step()
        scan.tick(world.now_s)
    assert set(scan.nodes) == {*DRIVES, *range(33, 49)}
    drive, board = scan.nodes[3], scan.nodes[40]
    assert (drive.state, drive.device_type, drive.serial_number, drive.device_name) == (
        "operational",
        0x20192,
        1003,
        "axis",
    )
    assert (board.state, board.product_code, board.serial_number) == ("operational", 0x534B494E, 8)
    assert [each.node_id for each in scan.nodes.values() if each.produces_sync] == [OTHER_PRODUCER]
    rates_hz = {each.cob_id: each.rate_hz for each in scan.identifiers}
    assert scan.sync_rate_hz == pytest.approx(100, abs=4)
    assert rates_hz[THEIR_SYNC] == pytest.approx(100, abs=4)
    assert rates_hz[0x181] == pytest.approx(100, abs=4)
    meanings = {each.cob_id: each.meaning for each in scan.identifiers}
    assert (meanings[0x181], meanings[0x728]) == ("TPDO 1 of 1", "heartbeat of 40")


def test_a_scan_that_only_listens_sends_nothing() -> None:
    sent = []
    scan = Scan(sent.append, 1_000_000, 0.0, listen_s=1.0, asks=False)  # type: ignore[arg-type]
    scan.tick(0.5)
    assert not scan.done
    scan.tick(1.0)
    assert scan.done
    assert sent == []


def test_a_scan_takes_a_small_part_of_the_bus() -> None:
    sent_s: list[float] = []
    now_s = 0.0
    scan = Scan(lambda burst: sent_s.append(now_s) or len(burst), 125_000, now_s, listen_s=0.1)
    while not scan.done and now_s < 100:
        now_s += 0.01
        scan.tick(now_s)
    # Requests and aborts of eight bytes, 135 bits at most, and as many responses that might come.
    assert len(sent_s) >= 2 * 127
    assert len(sent_s) * 2 * 135 / 125_000 / (sent_s[-1] - sent_s[0]) < 0.055
