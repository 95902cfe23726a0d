"""Limits of files from others: their size, keys and unpacked size are checked before they are parsed; for all rooms.

A small file can claim, or unpack to, thousands of times its size. With these limits a reader takes about 200 MB and 2 s
at most. Those of recordings are in `recording.mcap_file`, those of logs in `bandwidth.logs` and `log_file`.
"""

import codecs
import re
import zipfile
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO, Final

import msgspec

from canskin.errors import UNDECODABLE, InputError, LayoutError, SkinError, reasoned

#: Most bytes of a file that becomes many objects: JSON, XML, .dbc, EDS.
TEXT_BYTES_MAX: Final = 2**22
#: Most bytes of any other file: those of a layout of 2**16 taxels fit.
FILE_BYTES_MAX: Final = 2**24
#: Most bytes that the arrays of an .npz unpack to; more only if they take at most twice their file.
UNPACKED_BYTES_MAX: Final = 2**26
#: Most bytes of the directory of an .npz.
_DIRECTORY_BYTES_MAX: Final = 2**16
#: The last 42 bytes of an .npz (PKWARE APPNOTE 4.3.15 and 4.3.16): 20 that are no locator of a longer end, then the
#: end of the directory, with its size, and without a comment.
_TAIL: Final = re.compile(rb"(?!PK\x06\x07).{20}PK\x05\x06.{8}(?P<size>.{4}).{4}\0\0", re.DOTALL)
_TAIL_BYTES: Final = 42

#: Most parts of a key: the parser's memory grows with the square of their number.
_PARTS_MAX: Final = 8
#: A quoted part may itself hold dots: no pattern counts the parts then.
_QUOTED_MAX: Final = 100
_KEYS_MAX: Final = 2**13
#: Twelve for each of 2**16 taxels: a position, its normal and its place take ten lines of `skin.layout.layout_text`.
_LINES_MAX: Final = 12 * 2**16
#: Limits of a layout: most matches of a pattern, and the limit in words.
_TOML: Final = (
    (_LINES_MAX, re.compile(rb"\n"), f"at most {_LINES_MAX} lines"),
    (_LINES_MAX, re.compile(rb","), f"at most {_LINES_MAX} commas"),
    (_LINES_MAX, re.compile(rb"\\"), f"at most {_LINES_MAX} escapes"),
    (_KEYS_MAX, re.compile(rb"=|^[ \t]*\[.*\][ \t]*(?:#.*)?$", re.MULTILINE), f"at most {_KEYS_MAX} keys and tables"),
    (0, re.compile(rb"(?<![\w-])(?:[\w-]++[ \t]*+\.[ \t]*+){%d}" % _PARTS_MAX), f"keys of at most {_PARTS_MAX} parts"),
    (_QUOTED_MAX, re.compile(rb"""["'][ \t]*\.|\.[ \t]*["']"""), f"at most {_QUOTED_MAX} dots beside quotes"),
)


def check_bytes(size: int, kind: type[SkinError], origin: object, most: int = FILE_BYTES_MAX) -> None:
    """Raise `kind` for content of more than `most` bytes; `origin` names it."""
    if size > most:
        raise kind(f"{origin}: expected at most {most} bytes, got {size}")


def read_file(path: Path, kind: type[SkinError], what: str, most: int = FILE_BYTES_MAX) -> bytes:
    """Return the content of a file; raise `kind` if it cannot be read, or has more than `most` bytes."""
    with reasoned(kind, f"{path}: cannot read {what}"), path.open("rb") as file:
        check_bytes(path.stat().st_size, kind, path, most)
        content = file.read(most + 1)  # a pipe or device tells no size
    check_bytes(len(content), kind, path, most)
    return content


def read_text(path: Path, kind: type[SkinError], what: str, most: int = FILE_BYTES_MAX) -> str:
    """Return the text of a file, see `text_of`; raise `kind` as `read_file` does."""
    return text_of(read_file(path, kind, what, most))


def text_of(content: bytes) -> str:
    """Return the text of a file: UTF-8 or, with a byte-order mark, UTF-16; else Windows-1252, as of old programs."""
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return content.decode("utf-16", errors="replace")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("cp1252", errors="replace")


def decode_toml(content: bytes, origin: str) -> dict[str, Any]:
    """Return the tables of a layout; raise LayoutError if it is no TOML, or beyond a limit."""
    check_bytes(len(content), LayoutError, origin)
    content = text_of(content).encode()
    for most, pattern, words in _TOML:
        if next(islice(pattern.finditer(content), most, None), None):
            raise LayoutError(f"{origin}: expected {words}, got more")
    try:
        tables: dict[str, Any] = msgspec.toml.decode(content)
    except (*UNDECODABLE, ValueError) as error:  # a ValueError: a number of thousands of digits
        raise LayoutError(f"{origin}: expected TOML: {error}") from error
    return tables


def check_unpacked(file: BinaryIO, origin: object) -> None:
    """Raise InputError for an .npz that unpacks to too much; `file` is read from its beginning afterwards.

    An .npy is not packed: numpy takes memory for as much as the file holds.
    """
    size = file.seek(0, 2)
    most = max(UNPACKED_BYTES_MAX, 2 * size)
    if zipfile.is_zipfile(file):
        file.seek(max(0, size - _TAIL_BYTES))
        end = _TAIL.fullmatch(file.read().rjust(_TAIL_BYTES))
        directory = int.from_bytes(end["size"], "little") if end else size
        if end is None or directory > _DIRECTORY_BYTES_MAX:
            raise InputError(f"{origin}: expected an .npz with a directory of at most {_DIRECTORY_BYTES_MAX} bytes")
        with zipfile.ZipFile(file) as archive:
            unpacked = sum(each.file_size for each in archive.infolist())
        if unpacked > most:
            advice = "numpy.savez keeps larger arrays, not packed"
            raise InputError(f"{origin}: expected at most {most} bytes unpacked, got {unpacked}: {advice}")
    file.seek(0)
