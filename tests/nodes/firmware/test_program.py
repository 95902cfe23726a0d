"""Program download to boards in C: a board starts with the old or the new program, whatever interrupts the download."""

import binascii
import os
import random
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import canopen
import numpy as np
import pytest

from commissioning.program_update import ProgramUpdate
from dbc import indices as od
from dbc.canopen import Abort
from dbc.dictionary import REVISION
from dbc.eds import eds, node_types
from dbc.frame import Frames, frames
from dbc.program import FlashError, Program
from nodes.firmware.flash import SLOT_BYTES, Flash
from nodes.firmware.library import CompiledBoards, Firmware
from tests.bus.harness import frame
from tests.nodes.firmware.twins import needs_compiler, small_contract
from tests.nodes.helpers import ArrayLink, new_segment

pytestmark = needs_compiler

OLD = Program(0, 0x534B494E, REVISION, "1.0", b"canskin")
NEW = Program(0, 0x534B494E, REVISION, "2.0-rc1", random.Random(1).randbytes(500))


def _whole(_number: int, data: bytes) -> bytes:
    return data


def _never() -> bool:
    return False


class Bench:
    """One board in C, its flash memory, and the master; the test moves the clock."""

    def __init__(self, store: Path | None = None) -> None:
        if store is not None:
            store.mkdir(exist_ok=True)
        self.contract = small_contract()
        self.now_s = 10.0
        self.firmware = Firmware(self.contract, self.contract.nodes[:1], store=store)
        self.boards: CompiledBoards = self.firmware.boards(0)
        self.flash: Flash = self.boards._memories[0][1]
        #: Steps of the memory until its power ends: bytes that were written, and erased slots.
        self.steps_left = 1 << 60
        #: What the board gets of a frame of the master, by the frame's number.
        self.passes: Callable[[int, bytes], bytes | None] = _whole
        self.requests = 0
        self.waiting = frames(0)
        self.erase, self.write = self.flash.erase, self.flash.write
        self.flash.erase, self.flash.write = self._erase, self._write  # type: ignore[method-assign]
        self.has_power = True
        self.power_up()

    def power_up(self) -> None:
        """Cut the power, and give it back."""
        self.has_power, self.steps_left = True, 1 << 60
        self.waiting = self.boards.power_up(self.now_s)

    def _spend(self, steps: int) -> int:
        """Return how many steps the power lasts."""
        lasting = max(0, min(steps, self.steps_left))
        self.steps_left -= steps
        self.has_power = self.has_power and lasting == steps
        return lasting

    def _erase(self, slot: int) -> None:
        before = bytes(self.flash.slots[slot])
        if self._spend(8) == 8:
            self.erase(slot)
        else:  # some pages are erased, one holds anything
            at = random.Random(self.steps_left).randrange(len(before) + 1)
            self.flash.slots[slot][:at] = b"\xff" * at

    def _write(self, slot: int, at: int, data: bytes) -> None:
        lasting = self._spend(len(data))
        # The byte under way has some of its bits.
        torn = bytes((data[lasting] | 0xA5,)) if lasting < len(data) and self.steps_left > -len(data) else b""
        self.write(slot, at, data[:lasting] + torn)

    def send(self, burst: Frames) -> int:
        """Pass frames of the master to the board."""
        for each in burst:
            data = each["data"][: each["length"]].tobytes()
            self.requests += 1
            passed = self.passes(self.requests, data)
            if passed is not None and self.has_power:
                sent = self.boards.take(frame(int(each["can_id"]), passed), self.now_s)
                if self.has_power:
                    self.waiting = np.concatenate([self.waiting, sent])
        return len(burst)

    def update(self, program: Program, until: Callable[[], bool] = _never, image: bytes | None = None) -> ProgramUpdate:
        """Load a program, or a damaged image of it, to the end or until the master dies."""
        run = ProgramUpdate(program, [1], self.send, self.now_s)
        run._image = image or run._image
        while not run.done and not until():
            self.now_s += 0.01
            came, self.waiting = self.waiting, frames(0)
            run.take(came, self.now_s)
            if self.has_power:
                self.waiting = np.concatenate([self.waiting, self.boards.pass_time(self.now_s)])
            run.tick(self.now_s)
        return run

    def read(self, index: int, subindex: int) -> bytes:
        """Read an object of up to eight bytes."""
        request = bytes((0x40, index & 0xFF, index >> 8, subindex)).ljust(8, b"\0")
        answer = bytes(self.boards.take(frame(0x601, request), self.now_s)["data"][0, :8])
        if answer[0] & 0x02:
            return answer[4 : 8 - (answer[0] >> 2 & 3)]
        return bytes(self.boards.take(frame(0x601, b"\x60".ljust(8, b"\0")), self.now_s)["data"][0, 1 : 1 + answer[4]])

    @property
    def running(self) -> Program:
        """Which program the board says that it runs, by number and version."""
        said = int.from_bytes(self.read(od.PROGRAM_ID, 1), "little"), self.read(od.SOFTWARE_VERSION, 0)
        return {(each.identification, each.version.encode()): each for each in (OLD, NEW)}[said]


def test_a_board_gets_a_program_starts_it_and_says_so() -> None:
    bench = Bench()
    assert bench.running == OLD
    run = bench.update(NEW)
    assert (run.failed, run.outcomes[1].before, run.outcomes[1].after) == ([], OLD.identification, NEW.identification)
    assert bench.running == NEW
    requests = bench.requests
    assert bench.update(NEW).outcomes[1].result == "has run the program before"
    assert bench.requests == requests + 1
    assert bench.update(OLD).failed == []
    assert bench.running == OLD


def interrupt(bench: Bench, kind: str, chance: random.Random) -> None:
    """Load a program, and interrupt that at a random moment: about 95 frames, 590 bytes of flash memory."""
    at = bench.requests + chance.randrange(2, 95)
    image, until = NEW.image, _never
    if kind == "power while it writes":
        bench.steps_left = chance.randrange(600)
        until = lambda: not bench.has_power  # noqa: E731
    elif kind == "power":
        until = lambda: bench.requests >= at  # noqa: E731
    elif kind == "gateway dies":
        bench.passes = lambda number, data: data if number < at else None
        until = lambda: bench.requests >= at  # noqa: E731
    elif kind == "abort":
        bench.passes = lambda number, data: data if number != at else b"\x80\x50\x1f\x01" + bytes(4)
    elif kind == "lost":
        lost = {at, *(chance.randrange(at, at + 95) for _ in range(3))}
        bench.passes = lambda number, data: None if number in lost else data
    elif kind == "wrong byte":
        bench.passes = lambda number, data: data if number != at else data[:4] + bytes((data[4] ^ 8,)) + data[5:]
    elif kind == "wrong CRC":
        place = chance.randrange(20, len(image))
        image = image[:place] + bytes((image[place] ^ 1 << chance.randrange(8),)) + image[place + 1 :]
    else:
        image = replace(NEW, product_code=1).image
    run = bench.update(NEW, until, image)
    if image != NEW.image:
        assert run.failed == [1]
        assert bench.running == OLD
    bench.passes = _whole


KINDS = ("power while it writes", "power", "gateway dies", "abort", "lost", "wrong byte", "wrong CRC", "other product")
#: Random moments for each of these.
MOMENTS = int(os.environ.get("SKIN_DOWNLOADS", "104")) // len(KINDS)


@pytest.mark.heavy
@pytest.mark.parametrize("kind", KINDS)
def test_a_board_starts_with_the_old_or_the_new_program_whatever_ends_the_download(kind: str, tmp_path: Path) -> None:
    for seed in range(MOMENTS):
        bench = Bench(tmp_path / str(seed) if seed % 4 == 0 else None)
        interrupt(bench, kind, random.Random(seed))
        bench.power_up()
        assert bench.running in {OLD, NEW}
        assert bench.update(NEW).failed == [], seed
        bench.power_up()
        assert bench.running == NEW


@pytest.mark.heavy
def test_the_power_ends_at_each_byte_of_the_memory_and_the_program_changes_once() -> None:
    """Erasing has 8 steps, a write one for each byte; the board tells at the end of the download which it is."""
    bench, ran = Bench(), []
    for steps in range(0, 620, 7):
        bench.update(OLD)
        bench.steps_left = steps
        bench.update(NEW, until=lambda: not bench.has_power or not bench.steps_left)
        bench.power_up()
        ran.append(bench.running)
    changed = ran.index(NEW)
    assert ran == [OLD] * changed + [NEW] * (len(ran) - changed)
    assert changed > 540 // 7


def test_a_program_that_nobody_reaches_over_the_bus_gives_way_to_the_old_one() -> None:
    bench = Bench()

    def has_started() -> bool:
        return any(each["can_id"] == 0x701 and each["data"][0] == 0 for each in bench.waiting)

    bench.waiting = frames(0)
    bench.update(NEW, until=has_started)
    bench.power_up()  # the second start of the new program
    assert bench.running == OLD
    assert bench.update(NEW).failed == []
    for _ in range(3):
        bench.power_up()
        assert bench.running == NEW


def test_a_loaded_program_outlives_the_process_and_files_come_with_the_first_one(tmp_path: Path) -> None:
    assert Bench(tmp_path).running == OLD
    assert not list(tmp_path.iterdir())
    Bench(tmp_path).update(NEW)
    assert Bench(tmp_path).running == NEW
    assert [each.name for each in tmp_path.iterdir()] == ["bus0-1.slot1"]


def test_boards_without_memory_for_programs_and_nodes_in_python_say_that_they_have_none() -> None:
    contract = small_contract()
    link = ArrayLink()
    segment = new_segment(contract, link, {1})
    link.take_sent()

    def send(burst: Frames) -> int:
        segment.take(burst, 0.0)
        return len(burst)

    run = ProgramUpdate(NEW, [1], send, 0.0)
    run.take(link.take_sent(), 0.0)
    assert run.done
    assert "has no program download (object 1F56h:1: abort 06020000h" in run.outcomes[1].result
    assert run.failed == [1]


class Network(canopen.Network):
    """The library's master, whose requests the board answers at once."""

    def __init__(self, bench: Bench) -> None:
        super().__init__()
        self.bench = bench

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        for each in self.bench.boards.take(frame(can_id, bytes(data)), 0.0):
            self.notify(int(each["can_id"]), bytearray(each["data"][: each["length"]]), 0.0)


@pytest.mark.parametrize("in_blocks", [True, False])
def test_the_master_of_another_library_loads_and_starts_a_program(in_blocks: bool, tmp_path: Path) -> None:
    bench = Bench()
    (tmp_path / "board.eds").write_text(eds(bench.contract, node_types(bench.contract)[0]), "ascii")
    node = canopen.RemoteNode(1, str(tmp_path / "board.eds"))
    Network(bench).add_node(node)
    node.sdo[0x1F51][1].raw = 0
    node.sdo[0x1F51][1].raw = 3
    assert node.sdo[0x1F57][1].raw == 1 << 1
    with node.sdo[0x1F50][1].open("wb", size=len(NEW.image), block_transfer=in_blocks) as file:
        file.write(NEW.image)
    assert node.sdo[0x1F57][1].raw == 0
    assert node.sdo[0x1F56][1].raw == OLD.identification
    node.sdo[0x1F51][1].raw = 1
    assert node.sdo[0x1F56][1].raw == NEW.identification
    assert node.sdo[0x100A].raw == "2.0-rc1"
    with pytest.raises(canopen.SdoAbortedError, match="0x06010001"):
        node.sdo.upload(0x1F50, 1)


@pytest.mark.parametrize(
    ("image", "code", "error"),
    [
        (b"\0" * 40, Abort.VALUE, FlashError.FORMAT_UNKNOWN),
        (replace(NEW, vendor_id=9).image, Abort.INCOMPATIBLE, FlashError.FORMAT_UNKNOWN),
        (NEW.image[:-1], Abort.NOT_STORED, FlashError.DATA_ERROR),
        (NEW.image + b"\0", Abort.TOO_LONG, FlashError.DATA_ERROR),
        (NEW.image[:20], Abort.NOT_STORED, FlashError.DATA_ERROR),
        (replace(NEW, data=bytes(SLOT_BYTES)).image, Abort.TOO_LONG, FlashError.ADDRESS_ERROR),
    ],
)
def test_what_a_board_says_of_a_wrong_program(image: bytes, code: Abort, error: FlashError) -> None:
    bench = Bench()
    assert f"object 1F50h:1: abort {code:08X}h" in bench.update(NEW, image=image).outcomes[1].result
    assert bench.read(od.FLASH_STATUS, 1) == (error << 1).to_bytes(4, "little")
    node = canopen.RemoteNode(1, canopen.ObjectDictionary())
    Network(bench).add_node(node)
    with pytest.raises(canopen.SdoAbortedError, match="0x08000022"):
        node.sdo.download(0x1F51, 1, b"\1")
    bench.power_up()
    assert bench.running == OLD


def test_a_board_gives_up_a_block_download_that_its_master_left() -> None:
    bench = Bench()
    bench.passes = lambda number, data: data if number <= 40 else None
    bench.update(NEW, until=lambda: bench.requests > 40)
    bench.boards.take(frame(0x601, b"\x40\x08\x10".ljust(8, b"\0")), bench.now_s + 1)  # of another master
    bench.waiting = bench.boards.pass_time(bench.now_s + 2)
    aborts = [bytes(each["data"][:8]) for each in bench.waiting if each["can_id"] == 0x581]
    assert aborts == [b"\x80\x50\x1f\x01" + Abort.TIMEOUT.to_bytes(4, "little")]
    assert bench.running == OLD


@pytest.mark.parametrize(("error", "end"), [(0, "a100000000000000"), (1, "80501f0104000405")])
def test_blocks_are_acknowledged_up_to_a_gap_and_their_crc_counts(error: int, end: str) -> None:
    bench, image = Bench(), replace(NEW, data=b"12345678").image  # 40 bytes, 6 segments, 2 bytes of the last unused
    segments = [image[at : at + 7].ljust(7, b"\0") for at in range(0, 40, 7)]

    def ask(*requests: bytes) -> list[str]:
        sent = [bench.boards.take(frame(0x601, each), bench.now_s) for each in requests]
        return [bytes(each["data"][:8]).hex() for burst in sent for each in burst]

    def block(first: int, lost: int | None = None) -> list[str]:
        left = list(enumerate(segments[first:], 1))
        return ask(*(bytes((n | 0x80 * (n == len(left)),)) + each for n, each in left if n != lost))

    assert ask(b"\xc6\x50\x1f\x01" + (40).to_bytes(4, "little")) == ["a4501f017f000000"]
    assert block(0, lost=2) == ["a2017f0000000000"]
    assert block(1, lost=5) == []  # the end of the block is lost
    assert ask(b"\x85" + segments[5]) == ["a2057f0000000000"]
    crc = binascii.crc_hqx(image, 0) ^ error
    assert ask(b"\xc9" + crc.to_bytes(2, "little") + bytes(5)) == [end]
    assert bench.read(od.FLASH_STATUS, 1) == bytes((FlashError.NO_PROGRAM << 1 if error else 0, 0, 0, 0))
