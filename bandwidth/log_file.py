"""A log of CAN frames as python-can reads it: frame by frame, with the place of each, and with what was not read."""

import gzip
import re
import zlib
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Generator, Iterable, Iterator
from contextlib import contextmanager
from io import BufferedReader, StringIO, TextIOWrapper
from pathlib import Path
from typing import Final

import can
from can.io import blf
from can.io.player import MESSAGE_READERS

from bus.messages import CANDUMP_ERROR
from skin.limits import TEXT_BYTES_MAX

_File = BufferedReader | gzip.GzipFile
#: Encodings by the bytes that a text begins with.
_ENCODINGS: Final = {b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16", b"\xef\xbb": "utf-8-sig"}
#: A line of candump -l: time and channel, identifier, flags and data, raw DLC of a frame of 8 bytes, direction.
_LOGGED: Final = re.compile(
    r"\s*(\([-+.\de]+\)\s+\S+\s+)([\dA-F]{3,8})(#(?:#\d)?(?:R[0-8]?|(?:[\dA-F]{2})*))(?:_[9A-F])?(\s+[RT])?\s*$",
    re.IGNORECASE,
)
#: A CAN XL frame of candump: flags, type of the content, acceptance field.
_CAN_XL: Final = re.compile(r"#[0-9A-Fa-f]{2}:[0-9A-Fa-f]{2}:[0-9A-Fa-f]{8}#")
#: A line that candump prints on a terminal: length in brackets, then data.
_PRINTED: Final = re.compile(r"\s*(\(\S+( \S+)?\)\s+)?\S+\s+([TR]X\s+\S+\s+\S+\s+)?[0-9A-Fa-f]{3,8}\s+\[\d+\]")
#: Lines without a frame: comments, headers, states, statistics, and the requests of frames that follow themselves.
_NO_FRAME: Final = re.compile(
    r"\s*($|#|;|//|date\b|base\b|(no\s+)?internal\b|begin\b|end\b|timestamp\b"
    r"|[\d.]+\s+(start|log|trigger|SV:|J1939|CAN\s+\d+\s+status|\d+\s+(statistic|J1939|\w+\s+TxRq\b))"
    r"|\d+\)?\s+[\d.]+\s+(\d+\s+)?(ST|EC|EV|Warng)\b)",
    re.IGNORECASE,
)
_BASE: Final = re.compile(r"\s*base\s+(hex|dec)\b(.*\btimestamps\s+relative)?", re.IGNORECASE)
_ASC_TIME: Final = re.compile(r"\s*(\d+\.\d+)(?=\s)")
#: With this line ends the header of an ASC; python-can leaves out the first line behind a header without it.
_HEADER: Final = "no internal events logged\n"
#: An error frame in a TRC: number, time, in version 1.3 the bus; in version 2 the bus comes last.
_TRC_ERROR: Final = re.compile(r"\s*\d+\)?\s+([\d.]+)\s+(?:(\d+)\s+)?(?:Error\b|ER\b\s*(\d*))")
#: Longest line of a log.
_LINE_MAX: Final = 2**14
#: Kinds of objects of BLF that are error frames and that python-can does not know: of classic CAN, and of CAN FD.
_BLF_ERRORS: Final = (2, 104)


class LogFile:
    """The frames of a log, in its order; an iteration raises any exception where the log is damaged.

    Parameters
    ----------
    reader : iterable of can.Message
        Reads a log of which nothing else is known.

    Attributes
    ----------
    unit : str
        What `number` counts: lines, or frames.
    number : int
        Place of the newest frame, from 1.
    """

    unit = "frame"
    number = 0

    def __init__(self, reader: Iterable[can.Message]) -> None:
        self._reader = reader

    def __iter__(self) -> Generator[can.Message]:
        for message in self._reader:
            self.number += 1
            yield message

    def missing(self) -> Iterator[str]:
        """Yield, after the last frame, what a reader has to know of parts that were not read."""
        yield from ()


class _Text(LogFile, ABC):
    """A log of lines. A last line without line end is left out: a cut line may look like a shorter frame."""

    unit = "line"

    def __init__(self, file: _File) -> None:
        self._file = TextIOWrapper(file, _ENCODINGS.get(file.peek(2)[:2], "utf-8"), "replace")
        self._cut = ""
        #: Number of lines that were not read, and the first of them.
        self._unread = self._first_unread = 0

    def __iter__(self) -> Generator[can.Message]:
        while line := self._next():
            if (message := self._message(line)) is not None:
                yield message
            elif not _NO_FRAME.match(line):
                self._unread, self._first_unread = self._unread + 1, self._first_unread or self.number

    @abstractmethod
    def _message(self, line: str) -> can.Message | None: ...

    def _next(self) -> str:
        """Return the next whole line, empty at the end."""
        try:
            line = self._file.readline(_LINE_MAX)
        except EOFError:  # a compressed file that was cut
            line = "cut"
        if not line.endswith("\n") and len(line) < _LINE_MAX:
            if line and not re.match(r"\s*(//|End\b)", line, re.IGNORECASE):
                self._cut = f"line {self.number + 1} is cut off: read up to line {self.number}"
            return ""
        self.number += 1
        if len(line) == _LINE_MAX:
            raise ValueError(f"more than {_LINE_MAX} characters")
        if "\0" in line:
            raise ValueError("bytes of 0: the line was not written to its end, or the text is UTF-16 without a mark")
        return line

    def missing(self) -> Iterator[str]:
        if count := self._unread:
            first = f"line {self._first_unread}"
            which = first if count == 1 else f"{count} lines, the first is {first}"
            yield f"not read: {which}: expected a frame of CAN or CAN FD, or a comment"
        if self._cut:
            yield self._cut


class _Candump(_Text):
    def _message(self, line: str) -> can.Message | None:
        if _PRINTED.match(line):
            raise ValueError("it is what candump shows: record it with 'candump -l'")
        if _NO_FRAME.match(line) or _CAN_XL.search(line):
            return None
        if (found := _LOGGED.match(line)) is None:
            raise ValueError("expected a frame as 'candump -l' writes it")
        place, identifier, content, direction = found.groups("")
        is_error = len(identifier) > 3 and bool(int(identifier, 16) & CANDUMP_ERROR)
        plain = f"{int(identifier, 16) & ~CANDUMP_ERROR:0{len(identifier)}X}"
        message = next(iter(can.CanutilsLogReader(StringIO(place + plain + content + direction))))
        message.is_error_frame = is_error
        return message


class _Asc(_Text):
    _base, _is_relative, _time_s = "hex", False, 0.0

    def _message(self, line: str) -> can.Message | None:
        if (base := _BASE.match(line)) is not None:
            self._base, self._is_relative = base[1].lower(), base[2] is not None
        if self._is_relative and (time := _ASC_TIME.match(line)) is not None:  # to the event before, a frame or not
            self._time_s += float(time[1])
            line = f"{self._time_s:.9f}{line[time.end() :]}"
        if _NO_FRAME.match(line):
            return None
        return next(iter(can.ASCReader(StringIO(_HEADER + line), base=self._base)), None)


class _Trc(_Text, can.TRCReader):
    def __init__(self, file: _File) -> None:
        _Text.__init__(self, file)
        #: Its lines that python-can uses; empty when it was read.
        self._head = ";\n"
        can.TRCReader.__init__(self, StringIO())

    def _message(self, line: str) -> can.Message | None:
        line = line.strip()
        if not line or line.startswith(";"):
            self._head += f"{line}\n" * line.startswith(";$")
            return None
        if self._head:
            if "$FILEVERSION=1.2\n" in self._head:
                raise ValueError("expected version 1.0, 1.1, 1.3, 2.0 or 2.1 of TRC, got 1.2")
            self.file = StringIO(self._head + "\n")
            self._extract_header()
            self._head = ""
        if (error := _TRC_ERROR.match(line)) is None:
            return self._parse_line(line)
        time_s, channel = self._start_time + float(error[1]) / 1000, int(error[2] or error[3] or 1)
        return can.Message(timestamp=time_s, channel=channel, is_error_frame=True)


class _Csv(_Text):
    def _message(self, line: str) -> can.Message | None:
        if self.number == 1 and line[:1].isdigit():
            raise ValueError("expected the names of the columns, got a frame")
        return next(iter(can.CSVReader(StringIO("\n" + line)))) if self.number > 1 else None


class _Blf(LogFile, can.BLFReader):
    """Reads as python-can does, object by object, and no more than `TEXT_BYTES_MAX` of unpacked bytes at once."""

    def __init__(self, file: _File) -> None:
        can.BLFReader.__init__(self, file)  # type: ignore[arg-type]  # what it needs of a file
        self._cut = ""
        self._unread = Counter[int]()

    def __iter__(self) -> Generator[can.Message]:
        objects = place = 0
        while head := self.file.read(blf.OBJ_HEADER_BASE_STRUCT.size):
            place = self.file.tell() - len(head)
            if len(head) < blf.OBJ_HEADER_BASE_STRUCT.size:
                self._tail = self._tail or head
                break
            signature, _, _, size, kind = blf.OBJ_HEADER_BASE_STRUCT.unpack(head)
            if signature != b"LOBJ" or not len(head) <= size <= TEXT_BYTES_MAX:
                raise ValueError(f"a container of {size} bytes")
            content = self.file.read(size - len(head))
            is_cut = len(content) < size - len(head)
            self.file.read(size % 4)
            if kind == blf.LOG_CONTAINER:
                for each in self._objects(self._unpacked(content, is_cut=is_cut)):
                    objects += 1
                    yield from self._messages(each)
            elif not is_cut:
                self._unread[kind] += 1
            self._tail = self._tail or (head if is_cut else b"")
        if not self.object_count:
            self._cut = f"was not closed: what came after its {objects} objects is missing"
        elif self._tail.strip(b"\0") or objects < self.object_count:
            self._cut = f"ends at byte {place} with {objects} of its {self.object_count} objects: the rest is missing"

    def missing(self) -> Iterator[str]:
        if self._unread:
            named = ", ".join(f"{kind} ({count})" for kind, count in sorted(self._unread.items()))
            yield f"not read: objects of kinds {named}"
        if self._cut:
            yield self._cut

    def _unpacked(self, content: bytes, *, is_cut: bool) -> bytes:
        data, most = content[blf.LOG_CONTAINER_STRUCT.size :], TEXT_BYTES_MAX - len(self._tail)
        method = int.from_bytes(content[:2], "little")
        if method == blf.ZLIB_DEFLATE:
            unpacker = zlib.decompressobj()
            data = unpacker.decompress(data, most)
            if len(data) < most and not (unpacker.eof or is_cut):
                raise ValueError("a container that ends early")
        elif method != blf.NO_COMPRESSION:
            raise ValueError(f"a container that is packed in a way that is not known: {method}")
        if len(data) >= most:
            raise ValueError(f"expected at most {TEXT_BYTES_MAX} bytes unpacked, got more")
        return self._tail + data

    def _objects(self, data: bytes) -> Iterator[bytes]:
        """Yield the objects of a container, and keep the one that goes on in the next container."""
        place = 0
        while len(data) - place >= blf.OBJ_HEADER_BASE_STRUCT.size + 8:  # up to 8 bytes fill up the object before
            begin = data.find(b"LOBJ", place, place + 8)
            if begin < 0:
                raise ValueError("no object where one is due")
            size = blf.OBJ_HEADER_BASE_STRUCT.unpack_from(data, begin)[3]
            if size < blf.OBJ_HEADER_BASE_STRUCT.size:
                raise ValueError("an object of no length")
            if begin + size > len(data):
                break
            yield data[begin : begin + size]
            place = begin + size
        self._tail = data[place:]

    def _messages(self, found: bytes) -> Iterator[can.Message]:
        _, begin, _, _, kind = blf.OBJ_HEADER_BASE_STRUCT.unpack_from(found)
        if kind in _BLF_ERRORS:  # the kind that python-can knows has time and channel at the same places
            body = found[begin : begin + 1].ljust(blf.CAN_ERROR_EXT_STRUCT.size, b"\0")
            sized = (begin + len(body)).to_bytes(4, "little") + blf.CAN_ERROR_EXT.to_bytes(4, "little")
            found = found[:8] + sized + found[16:begin] + body
        before = self.number
        for message in self._parse_data(found):
            self.number += 1
            yield message
        if self.number == before:
            self._unread[kind] += 1


_KINDS: Final[dict[str, type[_Text | _Blf]]] = {
    ".log": _Candump, ".asc": _Asc, ".trc": _Trc, ".csv": _Csv, ".blf": _Blf,
}  # fmt: skip


@contextmanager
def open_log(path: Path) -> Iterator[LogFile]:
    """Open a log of the format of its suffix; a log of candump may have any other suffix.

    Raises
    ------
    Exception
        Of any kind, if the log is damaged.
    """
    is_packed = path.suffix.lower() == ".gz"
    suffix = (Path(path.stem) if is_packed else path).suffix.lower()
    kind = _KINDS.get(suffix, None if suffix in MESSAGE_READERS else _Candump)
    with gzip.open(path) if is_packed else path.open("rb") as file:
        if kind is not None and not (is_packed and kind is _Blf):
            yield kind(file)
            return
    if is_packed:
        raise ValueError("expected lines in a .gz")
    with can.LogReader(path) as reader:
        yield LogFile(reader)
