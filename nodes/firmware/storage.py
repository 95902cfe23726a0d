"""The storage function of C boards on this machine (``skin_storage.h``): the files of `nodes.storage`."""

import ctypes
from collections.abc import Iterator
from typing import Any, Final

from nodes.access import is_storable
from nodes.firmware.tables import COMPUTED, WRITABLE, ObjectTable
from nodes.storage import Parameters, Storage

#: Number of the record of 1010h.
_PARAMETERS: Final = 0
_DATA: Final = ctypes.POINTER(ctypes.c_uint8)
_FUNCTION: Final = ctypes.CFUNCTYPE(
    ctypes.c_int, ctypes.c_void_p, ctypes.c_uint8, ctypes.c_uint32, _DATA, ctypes.c_uint16
)


class StorageFunction(ctypes.Structure):
    """``skin_storage``: functions that load and save a record, and their context."""

    _fields_ = (("load", _FUNCTION), ("save", _FUNCTION), ("context", ctypes.c_void_p))


def storage_function(table: ObjectTable, storage: Storage) -> StorageFunction:
    """Return the storage function of a board with the objects of `table`, whose parameters `storage` keeps.

    Stored values that do not fit an object are left out: the board has its defaults there.
    """
    places = list(_places(table))

    def load(_context: int, record: int, _key: int, data: Any, _bytes: int) -> int:
        if record != _PARAMETERS or not storage.parameters:
            return 1
        values = bytearray(table.values[: table.writable_bytes])
        for index, subindex, data_type, at, length in places:
            found = storage.parameters.get(index, {}).get(subindex, b"")
            if is_storable(index, data_type, found):
                values[at : at + length] = found
        ctypes.memmove(data, bytes(values), len(values))
        return 0

    def save(_context: int, record: int, _key: int, data: Any, length: int) -> int:
        if record != _PARAMETERS:
            return 1
        try:
            if length:
                values = ctypes.string_at(data, length)
                parameters: Parameters = {}
                for index, subindex, _, at, size in places:
                    parameters.setdefault(index, {})[subindex] = values[at : at + size]
                storage.save(parameters)
            else:
                storage.clear()
        except OSError:
            return 1
        return 0

    return StorageFunction(_FUNCTION(load), _FUNCTION(save), None)


def _places(table: ObjectTable) -> Iterator[tuple[int, int, int, int, int]]:
    """Return index, sub-index, data type, place and length of each value that 1010h stores."""
    for (index, subindex, flags, at, length), each in zip(table.entries, table.objects, strict=True):
        if flags & WRITABLE and at != COMPUTED:
            yield index, subindex, each.data_type, at, length
