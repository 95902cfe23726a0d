"""``skin node update`` with a board of one slot and a bootloader that stays; its SDO server is another library's."""

import zlib
from pathlib import Path
from typing import Any

import canopen
import numpy as np
import pytest

from canskin.errors import InputError
from commissioning.node_options import NodeOptions
from commissioning.program_update import ProgramUpdate
from commissioning.program_update_command import update
from dbc.canopen import Abort
from dbc.dictionary import REVISION
from dbc.frame import Frames, frames
from dbc.program import Program
from tests.bus.harness import frame

NEW = Program(0, 0x534B494E, REVISION, "1.1", bytes(range(100)))
NODE_ID = 5


class OneSlot(canopen.Network):
    """A board whose bootloader starts the program of its slot, if that is whole. It knows no block transfer."""

    def __init__(self) -> None:
        super().__init__()
        self.out = frames(0)
        self.slot = Program(0, 0x534B494E, REVISION, "1.0", b"old").image
        self.objects = canopen.ObjectDictionary()
        for index, subindex, data_type in [
            *((0x1018, subindex, 7) for subindex in (1, 2)),
            *((index, 1, kind) for index, kind in ((0x1F50, 15), (0x1F51, 5), (0x1F56, 7), (0x1F57, 7))),
        ]:
            if index not in self.objects:
                self.objects.add_object(canopen.objectdictionary.ODRecord(f"{index:X}", index))
            variable = canopen.objectdictionary.ODVariable(f"{index:X}:{subindex}", index, subindex)
            variable.data_type, variable.access_type = data_type, "rw"
            self.objects[index].add_member(variable)  # type: ignore[union-attr]
        self.runs = True
        #: Questions that it answers with "busy" after each command.
        self.busy = 0
        self.answers_reset = True
        self.node = canopen.LocalNode(NODE_ID, self.objects)
        self.node.add_read_callback(self._read)  # type: ignore[no-untyped-call]
        self.node.add_write_callback(self._written)  # type: ignore[no-untyped-call]
        self.add_node(self.node)

    def reset(self, *, stays: bool = False) -> None:
        """Start the bootloader; it starts the program unless it is to stay, or there is none."""
        self.runs = not stays and self._is_whole()
        self.send_message(0x700 + NODE_ID, b"\0")

    def _is_whole(self) -> bool:
        crc = zlib.crc32(self.slot[32:], zlib.crc32(self.slot[:28]))
        return len(self.slot) > 32 and crc == int.from_bytes(self.slot[28:32], "little")

    def _read(self, *, index: int, subindex: int, **_: Any) -> int | None:
        if index == 0x1F57 and self.busy:
            self.busy -= 1
            return 1
        return {
            0x1018: (0, 0x534B494E)[subindex - 1],
            0x1F51: 1 if self.runs else 0,
            0x1F56: int.from_bytes(self.slot[28:32], "little") if self.runs else 0,
            0x1F57: 0 if self._is_whole() else 2,
        }.get(index)

    def _written(self, *, index: int, data: bytes, **_: Any) -> None:
        if index == 0x1F50:
            self.slot = data
        elif self.runs and data != b"\0":
            raise canopen.SdoAbortedError(Abort.STATE)
        elif data == b"\3":
            self.slot, self.busy = b"", 3
        elif data in (b"\0", b"\1"):
            self.reset(stays=data == b"\0")

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        self.out = np.concatenate([self.out, frame(can_id, bytes(data))])

    def send(self, burst: Frames) -> int:
        """Take frames of the master."""
        for each in burst:
            self.notify(int(each["can_id"]), bytearray(each["data"][: each["length"]]), 0.0)
        return len(burst)


def load(board: OneSlot, most: int = 1 << 30) -> ProgramUpdate:
    """Load the program; the master dies after `most` frames."""
    sent = 0

    def send(burst: Frames) -> int:
        nonlocal sent
        sent += len(burst)
        return board.send(burst) if sent <= most else 1

    now_s = 1.0
    run = ProgramUpdate(NEW, [NODE_ID], send, now_s)
    while not run.done and sent <= most:
        now_s += 0.01
        came, board.out = board.out, frames(0)
        run.take(came, now_s)
        run.tick(now_s)
    return run


def test_a_bootloader_that_stays_gets_the_program_in_segments() -> None:
    board = OneSlot()
    run = load(board)
    assert (run.failed, run.outcomes[NODE_ID].result) == ([], "started")
    assert (board.slot, board.runs) == (NEW.image, True)


def test_a_download_to_one_slot_is_cut_anywhere_and_the_next_completes_it() -> None:
    for most in range(2, 35):
        board = OneSlot()
        load(board, most)
        board.reset()
        board.out = frames(0)
        assert load(board).failed == [], most
        assert (board.slot, board.runs) == (NEW.image, True)


def test_a_silent_board_and_one_of_another_product_are_named_and_the_next_is_loaded() -> None:
    board = OneSlot()
    run = ProgramUpdate(Program(7, 0x534B494E, REVISION, "1", b"a"), [4, NODE_ID], board.send, 0.0)
    now_s = 0.0
    while not run.done:
        now_s += 0.01
        came, board.out = board.out, frames(0)
        run.take(came, now_s)
        run.tick(now_s)
    assert run.failed == [4, NODE_ID]
    assert run.outcomes[4].result == "no answer to object 1F56h:1"
    assert run.outcomes[NODE_ID].result == "the program is for boards with the vendor-ID 7h, this one has 0h"
    assert board.runs
    assert now_s == pytest.approx(3 * 0.3, abs=0.1)


@pytest.mark.parametrize(
    ("image", "said"),
    [
        (b"short", "expected a program with the header"),
        (NEW.image[:-1], "and 100 bytes behind it, got 99"),
        (NEW.image[:-1] + b"\0", "the program is damaged"),
        (Program(7, 8, REVISION, "1.1", b"a").image, "vendor-ID 0h and product code 534B494Eh of skin, got 7h and 8h"),
    ],
)
def test_a_file_that_is_no_program_for_the_skin_is_refused(image: bytes, said: str, tmp_path: Path) -> None:
    (tmp_path / "program.bin").write_bytes(image)
    with pytest.raises(InputError, match=said):
        update(tmp_path / "program.bin", of=NodeOptions(node=3, bus="bus0"))


def test_a_program_file_is_read_as_it_was_written(tmp_path: Path) -> None:
    (tmp_path / "program.bin").write_bytes(NEW.image)
    assert Program.read(tmp_path / "program.bin") == NEW
    head = NEW.image[:32]
    assert head[:28].hex() == "534b4e50" + "00000000" + "4e494b53" + "01000200" + "64000000" + b"1.1".hex() + "00" * 5
    assert int.from_bytes(head[28:], "little") == zlib.crc32(head[:28] + NEW.data)
