"""A log of CAN frames as python-can reads it: frame by frame, with the place of each, and with what was not read."""

import re
import zlib
from collections import Counter
from collections.abc import Generator, Iterator
from contextlib import ExitStack
from io import BufferedReader, TextIOWrapper
from pathlib import Path
from typing import BinaryIO, Final, Protocol, Self, cast

import can
from can.io import blf
from can.io.generic import MessageReader, TextIOMessageReader
from can.io.player import MESSAGE_READERS

from bus.messages import CANDUMP_ERROR
from skin.limits import TEXT_BYTES_MAX

#: Encodings by the bytes that a text begins with.
_ENCODINGS: Final = {b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16", b"\xef\xbb": "utf-8-sig"}
#: A line of a log of candump that holds no frame.
_COMMENT: Final = re.compile(r"\s*(#|;|//|$)")
#: An error frame of SocketCAN in a log of candump: the identifier contains CANDUMP_ERROR.
_ERROR_FRAME: Final = re.compile(r"(\s*\(\S+\)\s+\S+\s+)([23][0-9A-Fa-f]{7})(#.*)", re.DOTALL)
#: The raw DLC that candump adds to a frame of 8 bytes.
_RAW_DLC: Final = re.compile(r"(#(?:[0-9A-Fa-f]{16}|R8))_[9A-Fa-f]\b")
#: A CAN XL frame of candump: flags, type of the content, acceptance field.
_CAN_XL: Final = re.compile(r"#[0-9A-Fa-f]{2}:[0-9A-Fa-f]{2}:[0-9A-Fa-f]{8}#")
#: A line of candump -l: time, channel, identifier, data.
_LOGGED: Final = re.compile(r"\s*\(\d+(\.\d+)?\)\s+\S+\s+[0-9A-Fa-f]{3,8}#")
#: A line that candump prints on a terminal: length in brackets, then data.
_PRINTED: Final = re.compile(r"\s*(\(\S+( \S+)?\)\s+)?\S+\s+([TR]X\s+\S+\s+\S+\s+)?[0-9A-Fa-f]{3,8}\s+\[\d+\]")
#: Lines without a frame: comments, headers, states, statistics, and the requests of frames that follow themselves.
_NO_FRAME: Final = re.compile(
    r"\s*($|;|//|date\b|base\b|(no\s+)?internal\b|begin\b|end\b|timestamp,"
    r"|[\d.]+\s+(start|log|trigger|SV:|J1939|CAN\s+\d+\s+status|\d+\s+(statistic|J1939|\w+\s+TxRq\b))"
    r"|\d+\)?\s+[\d.]+\s+(\d+\s+)?(ST|EC|EV|Warng)\b)",
    re.IGNORECASE,
)
_REQUEST: Final = re.compile(r"\s*\S+\s+\d+\s+\w+\s+TxRq\b")
_RELATIVE: Final = re.compile(r"\s*base\b.*\btimestamps\s+relative", re.IGNORECASE)
_ASC_TIME: Final = re.compile(r"\s*(\d+\.\d+)(?=\s)")
#: An error frame in a TRC of version 1 (number, time, in 1.3 the bus), and of version 2 (time, bus).
_TRC_ERROR: Final = re.compile(r"(\s*\d+\)\s+[\d.]+\s+)(\d+\s+)?Error\b|\s*\d+\s+([\d.]+)\s+ER\b\s*(\S*)")
#: Longest line of a log.
_LINE_MAX: Final = 2**14
#: Kinds of objects of BLF that are error frames and that python-can does not know: of classic CAN, and of CAN FD.
_BLF_ERRORS: Final = (2, 104)


class _TextFile(Protocol):
    def readline(self, size: int) -> str: ...
    def close(self) -> None: ...


class _Lines:
    """The lines of a log as python-can's readers take them, with the number of the last line.

    A last line without line end is left out: a cut line may look like a shorter frame.
    """

    def __init__(self, file: _TextFile, reader: MessageReader) -> None:
        self._file, self._reader = file, reader
        self.text = self.cut = ""
        self.number = 0
        #: Number of lines that were not read, and the first of them.
        self.unread = self.first_unread = 0
        #: Whether the line is an error frame, which python-can reads as a frame of the bus.
        self.is_error = False
        #: Whether python-can made a frame of the line.
        self.is_taken = True
        self._is_relative, self._time_s = False, 0.0

    def __iter__(self) -> Iterator[str]:
        return self

    def __next__(self) -> str:
        while True:
            if not self.is_taken and not _NO_FRAME.match(self.text):
                self.unread, self.first_unread = self.unread + 1, self.first_unread or self.number
            self.text, self.is_taken, self.is_error = self._next(), False, False
            if (line := self._known(self.text)) is not None:
                return line

    def close(self) -> None:
        self._file.close()

    def _next(self) -> str:
        try:
            line = self._file.readline(_LINE_MAX)
        except EOFError:  # a compressed file that was cut
            line = "cut"
        if not line.endswith("\n") and len(line) < _LINE_MAX:
            if line and not re.match(r"\s*(//|End\b)", line, re.IGNORECASE):
                self.cut = f"line {self.number + 1} is cut off: read up to line {self.number}"
            self.is_taken = True
            raise StopIteration
        self.number += 1
        if len(line) == _LINE_MAX:
            raise ValueError(f"more than {_LINE_MAX} characters")
        if "\0" in line:
            raise ValueError("bytes of 0: the line was not written to its end, or the text is UTF-16 without a mark")
        return line

    def _known(self, line: str) -> str | None:
        """Return the line as python-can reads it; None for one that it would take for something else."""
        if isinstance(self._reader, can.CanutilsLogReader):
            return self._of_candump(line)
        if isinstance(self._reader, can.ASCReader):
            return self._of_asc(line)
        if isinstance(self._reader, can.TRCReader) and (error := _TRC_ERROR.match(line)) is not None:
            self.is_error = True
            if error[3] is None:
                return f"{error[1]}{error[2] or ''}Rx 0000 {'- ' if error[2] else ''}0\n"
            values = {"N": "1", "O": error[3], "T": "DT", "B": error[4], "I": "0000", "d": "Rx", "l": "0", "L": "0"}
            return " ".join(values.get(each, "-") for each in self._reader.columns) + "\n"
        if isinstance(self._reader, can.CSVReader) and self.number == 1 and line[:1].isdigit():
            raise ValueError("expected the names of the columns, got a frame")
        return line

    def _of_candump(self, line: str) -> str | None:
        if _COMMENT.match(line):
            self.is_taken = True
        if self.is_taken or _CAN_XL.search(line):
            return None
        if (error := _ERROR_FRAME.match(line)) is not None:
            self.is_error = True
            return f"{error[1]}{int(error[2], 16) & ~CANDUMP_ERROR:08X}{error[3]}"
        return _RAW_DLC.sub(r"\1", line)

    def _of_asc(self, line: str) -> str | None:
        self._is_relative |= _RELATIVE.match(line) is not None
        if self._is_relative and (time := _ASC_TIME.match(line)) is not None:  # to the event before, a frame or not
            self._time_s += float(time[1])
            line = f"{self._time_s:.9f}{line[time.end() :]}"
        return None if _REQUEST.match(line) else line


class _Blf(can.BLFReader):
    """Reads as python-can does, object by object, and no more than `TEXT_BYTES_MAX` of unpacked bytes at once."""

    def __init__(self, file: BinaryIO) -> None:
        super().__init__(file)
        self.place, self.cut = "its head", ""
        self.unread = Counter[int]()

    def __iter__(self) -> Generator[can.Message]:
        objects = 0
        while head := self.file.read(blf.OBJ_HEADER_BASE_STRUCT.size):
            self.place = f"byte {self.file.tell() - len(head)}"
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
                self.unread[kind] += 1
            self._tail = self._tail or (head if is_cut else b"")
        if not self.object_count:
            self.cut = f"was not closed: what came after its {objects} objects is missing"
        elif self._tail.strip(b"\0") or objects < self.object_count:
            self.cut = f"ends at {self.place} with {objects} of its {self.object_count} objects: the rest is missing"
        self.stop()

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
        messages = [*self._parse_data(found)]
        if not messages:
            self.unread[kind] += 1
        yield from messages


class LogFile:
    """The frames of a log, in its order.

    Attributes
    ----------
    unit : str
        What `number` counts: lines, or frames.

    Raises
    ------
    Exception
        Of any kind, from the constructor and while frames are read, if the log is damaged.
    """

    def __init__(self, path: Path) -> None:
        self._reader, self._lines = _reader(path), None
        self._count = 0
        if isinstance(self._reader, TextIOMessageReader):
            text = cast("TextIOWrapper", self._reader.file)
            head = cast("BufferedReader", text.buffer).peek(2)[:2]
            text.reconfigure(encoding=_ENCODINGS.get(head, "utf-8"), errors="replace")
            self._lines = self._reader.file = _Lines(text, self._reader)  # type: ignore[assignment]
        self.unit = "frame" if self._lines is None else "line"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._reader.stop()

    def __iter__(self) -> Iterator[can.Message]:
        for message in self._reader:
            self._count += 1
            if self._lines is not None:
                self._lines.is_taken = True
                message.is_error_frame |= self._lines.is_error
            yield message

    @property
    def number(self) -> int:
        """Place of the newest frame, from 1."""
        return self._count if self._lines is None else self._lines.number

    @property
    def place(self) -> str:
        """Where the log is being read."""
        return self._reader.place if isinstance(self._reader, _Blf) else f"{self.unit} {self.number}"

    @property
    def is_printed(self) -> bool:
        """Whether the newest line is one that candump shows on a terminal."""
        return self._lines is not None and _PRINTED.match(self._lines.text) is not None

    def missing(self) -> Iterator[str]:
        """Yield, after the last frame, what a reader has to know of parts that were not read."""
        if self._lines is not None and (count := self._lines.unread):
            first = f"line {self._lines.first_unread}"
            which = first if count == 1 else f"{count} lines, the first is {first}"
            yield f"not read: {which}: expected a frame of CAN or CAN FD, or a comment"
        if isinstance(self._reader, _Blf) and (kinds := self._reader.unread):
            named = ", ".join(f"{kind} ({count})" for kind, count in sorted(kinds.items()))
            yield f"not read: objects of kinds {named}"
        source = self._lines or self._reader
        if cut := getattr(source, "cut", ""):
            yield cut


def _reader(path: Path) -> MessageReader:
    """Return the reader of a log: by its suffix, or where no format has this suffix, that of candump by the content."""
    if path.suffix.lower() not in {*MESSAGE_READERS, ".gz"}:
        with path.open("rb") as file:
            head = file.read(2)
        with path.open(encoding=_ENCODINGS.get(head, "utf-8"), errors="replace") as text:
            lines = iter(lambda: text.readline(_LINE_MAX), "")
            first = next((line for line in lines if not _COMMENT.match(line)), "")
        if _LOGGED.match(first) or _PRINTED.match(first):
            return can.CanutilsLogReader(path)
    if path.suffix.lower() == ".blf":
        with ExitStack() as opened:
            reader = _Blf(opened.enter_context(path.open("rb")))
            opened.pop_all()  # the reader closes what it can read
        return reader
    found = can.LogReader(path)
    if path.suffix.lower() == ".gz" and not isinstance(found, TextIOMessageReader):
        raise ValueError("expected lines in a .gz")
    return found
