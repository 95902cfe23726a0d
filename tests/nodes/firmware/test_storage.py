"""Boards in C keep what 1010h stores: in the files of the Python nodes, and in two slots of flash memory."""

import ctypes
import struct
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

from dbc import indices as od
from dbc.canopen import NMT_COB_ID, SDO_REQUEST_BASE, Abort, NmtCommand
from dbc.generate import write_files
from nodes.firmware.export import constants, sources
from nodes.firmware.flash import Flash
from nodes.firmware.library import STANDARD_FLAGS, CompiledBoards, Firmware, compile_c
from nodes.firmware.storage import StorageFunction
from nodes.firmware.tables import builds
from nodes.storage import Storage
from tests.bus.harness import frame
from tests.nodes.firmware.twins import needs_compiler, small_contract

pytestmark = needs_compiler

HALF = struct.pack("<f", 0.5)


def boards_of(store: Path | None) -> CompiledBoards:
    contract = small_contract()
    boards = Firmware(contract, contract.nodes, store=store).boards(0)
    boards.power_up(0.0)
    return boards


def sdo(boards: CompiledBoards, command: int, index: int, subindex: int, data: bytes = b"") -> bytes:
    request = struct.pack("<BHB", command, index, subindex) + data
    (answer,) = boards.take(frame(SDO_REQUEST_BASE + 1, request.ljust(8, b"\0")), 0.0)
    return bytes(answer["data"][4:8])


def read_gain(boards: CompiledBoards) -> bytes:
    return sdo(boards, 0x40, od.GAIN, 3)


def store_half(boards: CompiledBoards) -> bytes:
    """Write a gain, store it, and write another; return what the board says of the storing."""
    sdo(boards, 0x23, od.GAIN, 3, HALF)
    answer = sdo(boards, 0x23, od.STORE, 1, b"save")
    sdo(boards, 0x23, od.GAIN, 3, struct.pack("<f", 7))
    return answer


def test_a_stored_gain_outlives_the_process_in_the_file_of_a_python_node(tmp_path: Path) -> None:
    assert store_half(boards_of(tmp_path)) == bytes(4)
    (path,) = tmp_path.iterdir()
    kept = Storage(small_contract().phi.fingerprint, path).parameters
    assert (path.name, kept[od.GAIN][3]) == ("bus0-1.json", HALF)
    again = boards_of(tmp_path)
    assert read_gain(again) == HALF
    sdo(again, 0x23, od.RESTORE, 1, b"load")
    assert not list(tmp_path.iterdir())
    assert read_gain(boards_of(tmp_path)) == struct.pack("<f", 1)


@pytest.mark.parametrize("store", [True, False])
def test_a_stored_gain_comes_back_at_a_reset(store: bool, tmp_path: Path) -> None:
    boards = boards_of(tmp_path if store else None)
    store_half(boards)
    boards.take(frame(NMT_COB_ID, bytes((NmtCommand.RESET_NODE, 0))), 0.0)
    assert read_gain(boards) == HALF


def test_a_full_disk_is_an_abort_and_loses_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    boards = boards_of(tmp_path)
    store_half(boards)
    monkeypatch.setattr(Path, "replace", lambda *_: (_ for _ in ()).throw(OSError(28, "No space left on device")))
    assert sdo(boards, 0x23, od.STORE, 1, b"save") == struct.pack("<I", Abort.HARDWARE)
    boards.take(frame(NMT_COB_ID, bytes((NmtCommand.RESET_NODE, 1))), 0.0)
    assert (read_gain(boards), read_gain(boards_of(tmp_path))) == (HALF, HALF)


def test_values_that_fit_no_object_stay_at_their_defaults(tmp_path: Path) -> None:
    kept = {od.GAIN: {3: b"\0\0\xc0\x7f", 4: b"\1", 5: HALF}, od.ROWS: {1: b"\0"}, 0x5000: {0: b"\1"}}
    Storage(small_contract().phi.fingerprint, tmp_path / "bus0-1.json").save(kept)
    boards = boards_of(tmp_path)
    assert [sdo(boards, 0x40, od.GAIN, sub) for sub in (3, 4, 5)] == [struct.pack("<f", 1)] * 2 + [HALF]


SLOT_BYTES = 64


class Cut(Flash):
    """Flash memory whose power ends after `steps_left` bytes that were erased or written."""

    def __init__(self, slots: Callable[..., StorageFunction]) -> None:
        super().__init__([bytes(SLOT_BYTES)] * 4, [], SLOT_BYTES)
        self.steps_left = 1 << 30
        self._storage = slots(ctypes.byref(self.driver))

    def _has_power(self) -> bool:
        self.steps_left -= 1
        return self.steps_left >= 0

    def erase(self, slot: int) -> None:
        for at in range(SLOT_BYTES):
            if self._has_power():
                self.slots[slot][at] = 0xFF

    def write(self, slot: int, at: int, data: bytes) -> None:
        assert at % 16 == 0
        for place, byte in enumerate(data, at):
            if self._has_power():
                super().write(slot, place, bytes((byte,)))

    def save(self, data: bytes, record: int = 0, key: int = 7) -> bool:
        there = (ctypes.c_uint8 * max(1, len(data)))(*data)
        return bool(self._storage.save(self._storage.context, record, key, there, len(data)) == 0)

    def load(self, length: int, record: int = 0, key: int = 7) -> bytes | None:
        there = (ctypes.c_uint8 * length)()
        found = self._storage.load(self._storage.context, record, key, there, length) == 0
        return bytes(there) if found else None


@cache
def _compiled(folder: Path) -> Callable[..., StorageFunction]:
    contract = small_contract()
    boards = builds(contract, contract.nodes[:1])
    paths = write_files(sources(boards, "slave") | constants(contract, boards), folder)
    compile_c(paths, folder / "slave.so", ["cc", *STANDARD_FLAGS, "-fPIC", "-shared"])
    slots = ctypes.CDLL(str(folder / "slave.so")).skin_slots
    slots.restype = StorageFunction
    return slots  # type: ignore[no-any-return]


@pytest.fixture
def flash(tmp_path_factory: pytest.TempPathFactory) -> Cut:
    return Cut(_compiled(tmp_path_factory.getbasetemp() / "slots"))


OLD, NEW = bytes(range(40)), bytes(range(100, 140))


def test_a_power_cut_at_any_byte_leaves_the_old_record_or_the_new_one(flash: Cut) -> None:
    assert flash.load(40) is None
    flash.save(b"other", record=1)
    outcomes = []
    for steps in range(SLOT_BYTES + 40 + 16 + 1):
        assert flash.save(OLD)
        flash.steps_left = steps
        said = flash.save(NEW)
        flash.steps_left = 1 << 30
        found = flash.load(40)
        assert found == (NEW if said else OLD)
        outcomes.append(said)
    assert outcomes.count(True) >= 1
    assert outcomes.count(False) > SLOT_BYTES
    assert flash.load(5, record=1) == b"other"


def test_the_newest_record_counts_beyond_the_last_number(flash: Cut) -> None:
    flash.save(OLD)
    for number in range(5):
        assert flash.save(bytes((number,)) * 8)
        assert flash.load(8) == bytes((number,)) * 8


def test_a_record_of_another_key_or_length_or_a_forgotten_one_is_not_found(flash: Cut) -> None:
    flash.save(OLD)
    assert (flash.load(40, key=8), flash.load(39)) == (None, None)
    assert not flash.save(bytes(SLOT_BYTES))
    assert flash.load(40) == OLD
    assert flash.save(b"")
    assert flash.load(40) is None
