"""Flash memory of C boards on this machine (``skin_flash``), with the slots of programs: in memory, and in files."""

import ctypes
from pathlib import Path
from typing import Any, Final

from canskin.errors import InputError
from dbc.contract import Contract, NodeContract
from dbc.dictionary import REVISION, VERSION
from dbc.program import Program
from dbc.slots import sealed

#: Bytes of each of the two slots of programs.
SLOT_BYTES: Final = 1 << 18
_DATA: Final = ctypes.POINTER(ctypes.c_uint8)
_ERASE: Final = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_uint8)
_MOVE: Final = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_uint8, ctypes.c_uint32, _DATA, ctypes.c_uint16)
_ERASED: Final = b"\xff"


class FlashDriver(ctypes.Structure):
    """``skin_flash``: functions that erase, write and read slots, and their context."""

    _fields_ = (
        ("erase", _ERASE),
        ("write", _MOVE),
        ("read", _MOVE),
        ("slot_bytes", ctypes.c_uint32),
        ("context", ctypes.c_void_p),
    )


class Flash:
    """Flash memory of slots: erasing sets all bits, writing clears bits.

    Parameters
    ----------
    slots : list of bytes
        What the slots hold; behind that they are erased.
    paths : list of Path
        File of each slot, which is read, and made when the slot is erased or written; empty for memory alone.
    slot_bytes : int

    Attributes
    ----------
    driver : FlashDriver
        For the library; it lives as long as this object.
    """

    def __init__(self, slots: list[bytes], paths: list[Path], slot_bytes: int = SLOT_BYTES) -> None:
        self.slots = [bytearray(each) for each in slots]
        self._paths = paths
        for slot, path in enumerate(paths):
            try:
                self.slots[slot] = bytearray(path.read_bytes()[:slot_bytes])
            except FileNotFoundError:
                continue
            except OSError as error:
                raise InputError(f"{path}: cannot read the stored program: {error.strerror or error}") from error
        self.driver = FlashDriver(_ERASE(self._erase), _MOVE(self._write), _MOVE(self._read), slot_bytes, None)

    def erase(self, slot: int) -> None:
        """Set all bits of a slot."""
        self.slots[slot] = bytearray()
        if self._paths:
            self._paths[slot].write_bytes(b"")

    def write(self, slot: int, at: int, data: bytes) -> None:
        """Clear the bits of a slot that `data` has not set, from place `at` on."""
        memory = self.slots[slot]
        first = min(at, len(memory))
        memory += _ERASED * (at + len(data) - len(memory))
        for place, byte in enumerate(data, at):
            memory[place] &= byte
        if self._paths:
            with self._paths[slot].open("r+b" if self._paths[slot].exists() else "w+b") as file:
                # A slot that no file had is written whole.
                first = first if file.seek(0, 2) >= first else 0
                file.seek(first)
                file.write(memory[first : at + len(data)])

    def _erase(self, _context: int, slot: int) -> int:
        try:
            self.erase(slot)
        except (IndexError, OSError):
            return 1
        return 0

    def _write(self, _context: int, slot: int, at: int, data: Any, count: int) -> int:
        try:
            self.write(slot, at, ctypes.string_at(data, count))
        except (IndexError, OSError):
            return 1
        return 0

    def _read(self, _context: int, slot: int, at: int, data: Any, count: int) -> int:
        there = bytes(self.slots[slot][at : at + count])
        ctypes.memmove(data, there.ljust(count, _ERASED), count)
        return 0


def flash_of_node(contract: Contract, node: NodeContract, folder: Path | None) -> Flash:
    """Return the memory of a board's programs: its files in `folder`, or memory.

    Slot 0 holds the program that the board was made with: this board's C code under another name. Every program that a
    virtual board starts is the same code; what it tells of the program is the header's.
    """
    device = contract.layout.device
    made_with = Program(device.vendor_id, device.product_code, REVISION, VERSION, b"canskin").image
    slot = sealed(0, 0, made_with)
    name = f"{contract.layout.bus[node.bus].name}-{node.node_id}"
    return Flash([slot, b""], [folder / f"{name}.slot{number}" for number in range(2)] if folder else [])
