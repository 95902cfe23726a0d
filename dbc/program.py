"""Programs of boards for program download (CiA 302-3): their header, and the values of 1F51h and 1F57h.

A program file is a header of `PROGRAM_HEAD` bytes and the program. All numbers are little endian.
"""

import struct
import zlib
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Final, Self

from canskin.errors import InputError
from skin.limits import read_file

#: The characters "SKNP", first byte first.
PROGRAM_MAGIC: Final = 0x504E_4B53
PROGRAM_HEAD: Final = 32
#: Places of numbers in the header; the version has the rest.
PROGRAM_AT_MAGIC: Final = 0
PROGRAM_AT_VENDOR: Final = 4
PROGRAM_AT_PRODUCT: Final = 8
PROGRAM_AT_SIZE: Final = 16
PROGRAM_AT_VERSION: Final = 20
PROGRAM_AT_CRC: Final = 28
_HEAD: Final = struct.Struct("<5I8s")
VERSION_BYTES: Final = 8


class ProgramControl(IntEnum):
    """Values of 1F51h; read, the newest command that was obeyed."""

    STOP = 0
    START = 1
    RESET = 2
    CLEAR = 3


class FlashError(IntEnum):
    """Bits 1 to 7 of 1F57h; bit 0 tells that the memory is busy."""

    NO_ERROR = 0
    NO_PROGRAM = 1
    FORMAT_UNKNOWN = 2
    DATA_ERROR = 3
    NOT_CLEARED = 4
    WRITE_ERROR = 5
    ADDRESS_ERROR = 6
    SECURED = 7
    UNSPECIFIED = 63


@dataclass(frozen=True)
class Program:
    """A program with what its header says.

    Attributes
    ----------
    vendor_id, product_code, revision : int
        Of the boards that the program is for, and of these boards while the program runs (1018h:1 to 1018h:3).
    version : str
        1 to `VERSION_BYTES` printable characters of ASCII (100Ah).
    data : bytes
        What the processor runs.
    """

    vendor_id: int
    product_code: int
    revision: int
    version: str
    data: bytes

    @property
    def image(self) -> bytes:
        """Header and program, as the file has them and as 1F50h takes them."""
        numbers = (PROGRAM_MAGIC, self.vendor_id, self.product_code, self.revision, len(self.data))
        head = _HEAD.pack(*numbers, self.version.encode("ascii"))
        return head + struct.pack("<I", zlib.crc32(self.data, zlib.crc32(head))) + self.data

    @property
    def identification(self) -> int:
        """The value of 1F56h while the program runs: the header's CRC-32, over the header before it and the program."""
        return int.from_bytes(self.image[PROGRAM_AT_CRC:PROGRAM_HEAD], "little")

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read a program file; InputError if it is none, or damaged."""
        image = read_file(path, InputError, "the program")
        wanted = "expected a program with the header of 'skin contract --program'"
        if len(image) <= PROGRAM_HEAD or int.from_bytes(image[:4], "little") != PROGRAM_MAGIC:
            raise InputError(f"{path}: {wanted}, got {len(image)} bytes without it")
        _, vendor_id, product_code, revision, size, version = _HEAD.unpack(image[:PROGRAM_AT_CRC])
        if size != len(image) - PROGRAM_HEAD:
            raise InputError(f"{path}: {wanted} and {size} bytes behind it, got {len(image) - PROGRAM_HEAD}")
        text = version.rstrip(b"\0").decode("ascii", "replace")
        found = cls(vendor_id, product_code, revision, text, image[PROGRAM_HEAD:])
        if not is_version(text) or found.image != image:
            raise InputError(f"{path}: the program is damaged: its CRC-32 is wrong; make or copy the file again")
        return found


def is_version(text: str) -> bool:
    """Tell whether a text can be a version of a program."""
    return 1 <= len(text) <= VERSION_BYTES and text.isascii() and text.isprintable()
