"""The storage function of C boards on this machine (``skin_storage.h``): the files of `nodes.storage`."""

import ctypes
import struct
import zlib
from collections.abc import Iterator
from typing import Any, Final

from dbc import indices as od
from dbc.canopen import NO_BIT_TIMING, NO_NODE_ID
from dbc.configuration import setting_of
from dbc.slots import Record
from nodes.access import is_storable
from nodes.firmware.tables import COMPUTED, WRITABLE, Build, ObjectTable
from nodes.storage import Parameters, Storage

_DATA: Final = ctypes.POINTER(ctypes.c_uint8)
_FUNCTION: Final = ctypes.CFUNCTYPE(
    ctypes.c_int, ctypes.c_void_p, ctypes.c_uint8, ctypes.c_uint32, _DATA, ctypes.c_uint16
)


class StorageFunction(ctypes.Structure):
    """``skin_storage``: functions that load and save a record, and their context."""

    _fields_ = (("load", _FUNCTION), ("save", _FUNCTION), ("context", ctypes.c_void_p))


def storage_function(build: Build, storage: Storage) -> StorageFunction:
    """Return the storage function of a board, whose parameters and node-ID `storage` keeps.

    Stored values that do not fit an object are left out: the board has its defaults there.
    """
    places = list(_places(build.objects))

    def load(_context: int, record: int, key: int, data: Any, _bytes: int) -> int:
        if record == Record.LSS:
            kept = b"" if storage.node_id == NO_NODE_ID else bytes((storage.node_id, NO_BIT_TIMING))
        else:
            kept = _values(build, storage) if key == _key(build.objects, storage.owner) else b""
        ctypes.memmove(data, kept, len(kept))
        return int(not kept)

    def save(_context: int, record: int, _key: int, data: Any, length: int) -> int:
        try:
            if record == Record.LSS:
                storage.save_node_id(data[0])
            elif length:
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


def _key(table: ObjectTable, node_id: int) -> int:
    """Return the key of the values that a node-ID has stored (`key_of` of ``skin_objects.c``)."""
    (fingerprint,) = (setting_of(each).data for each in table.objects if each.index == od.PHI_FINGERPRINT)
    key = zlib.crc32(bytes((node_id,)), zlib.crc32(fingerprint))
    for index, subindex, flags, _, size in table.entries:
        if flags & WRITABLE:
            key = zlib.crc32(struct.pack("<HBB", index, subindex, size), key)
    return key


def _values(build: Build, storage: Storage) -> bytes:
    """Return the stored values, with defaults for those that fit no object; nothing if none are stored."""
    values = bytearray(build.values[: build.objects.writable_bytes] if storage.parameters else b"")
    for index, subindex, data_type, at, length in _places(build.objects):
        found = storage.parameters.get(index, {}).get(subindex, b"")
        if is_storable(index, data_type, found):
            values[at : at + length] = found
    return bytes(values)


def _places(table: ObjectTable) -> Iterator[tuple[int, int, int, int, int]]:
    """Return index, sub-index, data type, place and length of each value that 1010h stores."""
    for (index, subindex, flags, at, length), each in zip(table.entries, table.objects, strict=True):
        if flags & WRITABLE and at != COMPUTED:
            yield index, subindex, each.data_type, at, length
