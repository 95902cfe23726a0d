"""Boards in C keep what 1010h stores in two slots of flash memory."""

import ctypes
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

from dbc.generate import write_files
from nodes.firmware.export import constants, sources
from nodes.firmware.flash import Flash
from nodes.firmware.library import STANDARD_FLAGS, compile_c
from nodes.firmware.storage import StorageFunction
from nodes.firmware.tables import builds
from tests.nodes.firmware.twins import needs_compiler, small_contract

pytestmark = needs_compiler

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
