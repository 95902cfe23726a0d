"""Program download to boards in C: a board starts with the old or the new program, whatever interrupts the download."""

import random
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dbc import indices as od
from dbc.contract import Contract
from dbc.frame import Frames, frames
from dbc.program import Program
from gateway.program_update import ProgramUpdate
from nodes.firmware.flash import Flash
from nodes.firmware.library import CompiledBoards, Firmware
from tests.bus.harness import frame
from tests.nodes.firmware.twins import needs_compiler, small_contract

pytestmark = needs_compiler

OLD = Program(0, 0x534B494E, 0x10002, "1.0", b"canskin")
NEW = Program(0, 0x534B494E, 0x10002, "2.0-rc1", random.Random(1).randbytes(500))


class PowerCutError(Exception):
    """The power ends."""


class Bench:
    """One board in C, its flash memory, and the master; the test moves the clock."""

    def __init__(self, contract: Contract | None = None, store: Path | None = None) -> None:
        self.contract = contract or small_contract()
        self.now_s = 10.0
        self.firmware = Firmware(self.contract, self.contract.nodes[:1], store=store)
        self.boards: CompiledBoards = self.firmware.boards(0)
        self.flash: Flash = self.boards._memories[0][1]
        #: Steps of the memory until its power ends: bytes that were written, and erased slots.
        self.steps_left = 1 << 60
        #: What happens to frames from the master, by their number; the board gets what is returned.
        self.passes: Callable[[int, bytes], bytes | None] = lambda _number, data: data
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

    def update(self, program: Program, until: Callable[[], bool] = lambda: False) -> ProgramUpdate:
        """Load a program, to the end, or until the master dies."""
        run = ProgramUpdate(program, [1], self.send, self.now_s)
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


def interrupted(bench: Bench, kind: str, chance: random.Random) -> None:
    """Interrupt a download at a random moment."""
    at = chance.randrange(2, 95)  # of about 95 frames
    program = NEW
    bench.requests = 0
    if kind == "power":
        bench.steps_left = chance.randrange(600)
        bench.update(program, until=lambda: not bench.has_power)
    elif kind == "power between":
        bench.update(program, until=lambda: bench.requests >= at)
    elif kind == "gateway dies":
        bench.passes = lambda number, data: data if number < at else None
        bench.update(program, until=lambda: bench.requests >= at)
    elif kind == "abort":
        bench.passes = lambda number, data: data if number != at else b"\x80\x50\x1f\x01" + bytes(4)
        bench.update(program)
    elif kind == "lost":
        lost = {chance.randrange(2, 95) for _ in range(4)}
        bench.passes = lambda number, data: None if number in lost else data
        bench.update(program)
    elif kind == "wrong byte":
        bench.passes = lambda number, data: data if number != at else data[:4] + bytes((data[4] ^ 8,)) + data[5:]
        bench.update(program)
    elif kind == "wrong CRC":
        image = bytearray(program.image)
        image[chance.randrange(24, len(image))] ^= 1 << chance.randrange(8)
        wrong = ProgramUpdate(program, [], bench.send, bench.now_s)
        assert wrong.done
        spoil(bench, bytes(image))
    else:
        spoil(bench, replace(program, product_code=1).image)
    bench.passes = lambda _number, data: data


def spoil(bench: Bench, image: bytes) -> None:
    """Load an image that no board must start."""
    run = ProgramUpdate(NEW, [1], bench.send, bench.now_s)
    run._image = image
    while not run.done:
        bench.now_s += 0.01
        came, bench.waiting = bench.waiting, frames(0)
        run.take(came, bench.now_s)
        run.tick(bench.now_s)
    assert run.failed == [1]
    assert bench.running == OLD


KINDS = ("power", "power between", "gateway dies", "abort", "lost", "wrong byte", "wrong CRC", "other product")


@pytest.mark.parametrize("kind", KINDS)
def test_a_board_starts_with_the_old_or_the_new_program_at_a_hundred_random_moments(kind: str) -> None:
    outcomes = set()
    for seed in range(100):
        bench = Bench()
        interrupted(bench, kind, random.Random(seed))
        bench.power_up()
        outcomes.add(bench.running.version)
        assert bench.update(NEW).failed == [], seed
        bench.power_up()
        assert bench.running == NEW
    assert outcomes <= {"1.0", "2.0-rc1"}
