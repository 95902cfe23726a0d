"""Slots of a board's memory: what its records are, and how one is sealed (``skin_slots.h``)."""

import struct
import zlib
from enum import IntEnum
from typing import Final

#: Bytes before the data of a slot: number of the copy, 1 above that of the older one, key, bytes of data, and CRC-32 of
#: these and of the data.
SLOT_HEAD: Final = 16


class Record(IntEnum):
    """What a board keeps: the values that 1010h stores, and the node-ID with the bit rate that LSS has given."""

    PARAMETERS = 0
    LSS = 1


def sealed(number: int, key: int, data: bytes) -> bytes:
    """Return a whole slot, little endian: its head and its data."""
    head = struct.pack("<3I", number, key, len(data))
    return head + struct.pack("<I", zlib.crc32(data, zlib.crc32(head))) + data
