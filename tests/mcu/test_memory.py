"""Flash memory of emulated boards: programs and stored values, whatever ends the write."""

import contextlib
import random
import time
from collections.abc import Iterator
from pathlib import Path

from commissioning.program_update import ProgramUpdate
from dbc import indices as od
from dbc.program import Program
from gateway.sdo import Read, Write
from tests.mcu.build import BOARDS, Images
from tests.mcu.machine import BRANCH_TO_ITSELF, Machine, made_with, program_of
from tests.mcu.master import ATTEMPTS, Master, PowerCutError, patiently
from tests.mcu.watched_gateway import WatchedGateway
from tests.processes import Verb

#: The board of the tests.
NODE = 2
PROGRAM_ID = Read(od.PROGRAM_ID, 1, od.UNSIGNED32)
HEARTBEAT = Read(od.HEARTBEAT_MS, 0, od.UNSIGNED16)
#: Milliseconds: what is stored before, and after.
OLD_MS, NEW_MS = 700, 900
#: Cuts of the power in a download; and in a store, after how long.
CUTS, STORE_CUTS_S = 4, (0.0, 0.002, 0.005, 0.01, 0.02)


@contextlib.contextmanager
def master_of(machine: Machine) -> Iterator[Master]:
    with machine.link() as link:
        yield Master(link, machine.cut_power)


def identification(master: Master) -> int:
    return int.from_bytes(master.transfer(NODE, PROGRAM_ID), "little")


def newer(images: Images, version: str = "2.0") -> Program:
    """Return a program that says something else when it starts."""
    data = images.program(NODE)
    assert b"board up" in data
    return program_of(images.contract, version, data.replace(b"board up", b"board II"))


def load(master: Master, program: Program) -> None:
    """Load a program until the board runs it."""
    for _ in range(ATTEMPTS):
        run = ProgramUpdate(program, [NODE], master.send, time.monotonic())
        master.lead(run)
        if not run.failed:
            return
    raise AssertionError(run.outcomes)


def test_a_board_is_updated_over_the_bus_and_measures(machine: Machine, skin: Verb, tmp_path: Path) -> None:
    program = tmp_path / "new.bin"
    program.write_bytes(newer(machine.images).image)
    patiently(skin, "node", "update", program, "--node", NODE, *machine.on_bus)
    assert "board II" in machine.said
    with machine.link() as link:
        WatchedGateway(machine.images.contract, link).run_until_whole()


def test_a_program_that_hangs_gives_way_to_the_one_before(machine: Machine) -> None:
    images = machine.images
    data = bytearray(images.program(NODE))
    at = (images.symbols(NODE)["skin_tick"] & ~1) - images.symbols(NODE)["_start"]
    data[at : at + 2] = BRANCH_TO_ITSELF.to_bytes(2, "little")
    with master_of(machine) as master:
        run = ProgramUpdate(program_of(images.contract, "bad", bytes(data)), [NODE], master.send, time.monotonic())
        master.lead(run, lambda: "watchdog" in machine.said)
        assert identification(master) == made_with(images, NODE).identification
    assert "watchdog" in machine.said


def test_a_power_cut_in_a_download_leaves_the_old_program_or_the_new_one(machine: Machine) -> None:
    draw = random.Random(3)
    old, new = made_with(machine.images, NODE), newer(machine.images)
    # The frames that the end of a download takes are few: half of the cuts are there.
    frames = len(new.image) // 7
    cuts = [draw.randrange(frames) for _ in range(CUTS // 2)] + [frames + draw.randrange(20) for _ in range(CUTS // 2)]
    for cut in cuts:
        with master_of(machine) as master:
            master.frames_left = cut
            with contextlib.suppress(PowerCutError):
                load(master, new)
        machine.cut_power()
        machine.start()
        with master_of(machine) as master:
            runs = identification(master)
            assert runs in (old.identification, new.identification), cut
            if runs == new.identification:
                old, new = new, newer(machine.images, f"3.{cut}")
    with master_of(machine) as master:
        load(master, new)


def test_a_power_cut_in_a_store_leaves_the_old_values_or_the_new_ones(machine: Machine) -> None:
    store = Write(od.STORE, 1, od.SIGNATURE_SAVE.to_bytes(4, "little"))
    old_ms, new_ms = OLD_MS, NEW_MS
    with master_of(machine) as master:
        master.transfer(NODE, Write(od.HEARTBEAT_MS, 0, old_ms.to_bytes(2, "little")))
        master.transfer(NODE, store)
    for cut_s in STORE_CUTS_S:
        with master_of(machine) as master:
            master.transfer(NODE, Write(od.HEARTBEAT_MS, 0, new_ms.to_bytes(2, "little")))
            machine.order(f"t{0x600 + NODE:03X}8{store.request.hex()}")
            time.sleep(cut_s)
            machine.cut_power()
        machine.start()
        with master_of(machine) as master:
            found = int.from_bytes(master.transfer(NODE, HEARTBEAT), "little")
        assert found in (old_ms, new_ms), cut_s
        old_ms, new_ms = found, OLD_MS + NEW_MS - found


def test_boards_without_switches_are_commissioned_and_keep_their_node_ids(
    built: dict[str, Images], skin: Verb, tmp_path: Path
) -> None:
    with Machine(built["classic"], tmp_path, has_switches=False) as machine:
        patiently(skin, "commission", *machine.on_bus[2:])
        machine.cut_power()
        machine.start()
        with machine.link() as link:
            gateway = WatchedGateway(machine.images.contract, link)
            gateway.run_until_whole()
            assert gateway.checked >= BOARDS
