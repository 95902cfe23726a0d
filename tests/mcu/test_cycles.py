"""Boards in cycles: a valid block holds what the converters of its board showed at its SYNC, whatever goes wrong."""

import struct
from pathlib import Path

import pytest

from dbc.canopen import HEARTBEAT_BASE
from tests.mcu.build import BOARDS, Images
from tests.mcu.machine import Machine
from tests.mcu.master import ATTEMPTS, patiently
from tests.mcu.sizes import check_sizes
from tests.mcu.watched_gateway import PressedGateway, WatchedGateway
from tests.processes import Verb

#: Kinds of boards as ``docs/firmware.md`` calls them.
KINDS = {"classic": "synchronous, classic CAN", "fd": "synchronous, CAN FD, 4 blocks", "steps": "steps, classic CAN"}


def counts(machine: Machine, cpu: int) -> tuple[int, int, int, int]:
    """Return the frames of a board that were received, sent, lost and given up (``port_counts``)."""
    found = struct.unpack("<4I", machine.peek(machine.images.symbols(cpu)["port_count"], 16))
    return found[0], found[1], found[2], found[3]


@pytest.mark.parametrize("kind", ["classic", "fd"])
def test_boards_keep_the_contract_and_measure(kind: str, built: dict[str, Images], skin: Verb, tmp_path: Path) -> None:
    with Machine(built[kind], tmp_path) as machine:
        patiently(skin, "node", "check", "--node", BOARDS, *machine.on_bus)
        with machine.link() as link:
            gateway = WatchedGateway(machine.images.contract, link)
            gateway.run_until_whole()
            gateway.run(2.0)
        assert gateway.complete > 0
        check_sizes(machine, KINDS[kind])


def test_stepped_boards_keep_the_contract_and_send_a_pressure(
    built: dict[str, Images], skin: Verb, tmp_path: Path
) -> None:
    with Machine(built["steps"], tmp_path) as machine:
        with machine.link() as link:
            gateway = PressedGateway(machine.images.contract, link)
            gateway.until(lambda: gateway.is_pressed, "the pressure")
            gateway.run(2.0)
        assert gateway.checked > 0
        patiently(skin, "node", "check", "--node", 1, *machine.on_bus)
        check_sizes(machine, KINDS["steps"])


def test_a_lost_sync_makes_no_block_wrong(machine: Machine) -> None:
    with machine.link() as link:
        gateway = WatchedGateway(machine.images.contract, link)
        gateway.run_until_whole()
        for lost in (1, 2, 5):
            machine.order(f"L{lost:02x}")
            gateway.run(0.3 * lost)
            gateway.run_until_whole()


def test_a_board_that_hangs_is_restarted_by_its_watchdog(machine: Machine) -> None:
    symbols = machine.images.symbols(2)
    with machine.link() as link:
        gateway = WatchedGateway(machine.images.contract, link)
        gateway.run_until_whole()
        machine.hang(symbols["skin_tick"])
        gateway.until(lambda: not gateway.newest[1], "the hanging board to be missed")
        gateway.until(lambda: "watchdog" in machine.said, "the watchdog")
        gateway.run_until_whole()


def test_an_overrun_of_the_receive_queue_makes_no_block_wrong(machine: Machine) -> None:
    symbols = machine.images.symbols(2)
    burst = [f"t{HEARTBEAT_BASE + 0x70:03X}105"] * 80
    with machine.link() as link:
        gateway = WatchedGateway(machine.images.contract, link)
        gateway.run_until_whole()
        for _ in range(ATTEMPTS):
            before = counts(machine, 2)[2]
            machine.hang(symbols["skin_tick"], *burst)
            gateway.run(0.3)
            has_lost = counts(machine, 2)[2] > before
            gateway.run_until_whole()
            if has_lost:
                return
    pytest.fail("no frame was lost")
