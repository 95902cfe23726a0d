"""Frames of a bus, from a log that python-can reads or from a live bus."""

import re
import select
import time
import zlib
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import ExitStack
from io import TextIOWrapper
from pathlib import Path
from typing import Final, Protocol, cast

import can
import numpy as np
from can.io import blf
from can.io.generic import MessageReader, TextIOMessageReader
from can.io.player import MESSAGE_READERS

from bus.link import DISCARDED, Link
from bus.messages import to_logged_frames
from canskin.errors import InputError
from dbc.canopen import EXTENDED_ID_MASK
from dbc.frame import Frames, frames
from dbc.stored_frames import from_bytes
from recording import is_recording
from skin.layout import Layout
from skin.limits import TEXT_BYTES_MAX

#: Largest time stamp, seconds since the epoch: in 2261, a year before nanoseconds end that 64 bits hold.
_LATEST_S: Final = 9.2e9
#: An error frame of SocketCAN in a log of candump: the identifier contains CAN_ERR_FLAG.
_ERROR_FRAME: Final = re.compile(r"(\s*\(\S+\)\s+\S+\s+)([23][0-9A-Fa-f]{7})(#.*)", re.DOTALL)
_ERROR_FLAG: Final = 0x20000000
#: A line of candump -l: time, channel, identifier, data.
_LOGGED: Final = re.compile(r"\s*\(\d+(\.\d+)?\)\s+\S+\s+[0-9A-Fa-f]{3,8}#")
#: A line that candump prints on a terminal: length in brackets, then data.
_PRINTED: Final = re.compile(r"\s*(\(\S+( \S+)?\)\s+)?\S+\s+([TR]X\s+\S+\s+\S+\s+)?[0-9A-Fa-f]{3,8}\s+\[\d+\]")
#: Longest line of a log.
_LINE_MAX: Final = 2**14
#: A log has at most a frame for two of its bytes, or this many: more only of a file that unpacks to thousands of times
#: its size.
_FRAMES_MAX: Final = 2**16
#: An object of BLF without a length, at which python-can would stay for ever.
_ENDLESS: Final = re.compile(rb"LOBJ....[\x00-\x0f]\0\0\0", re.DOTALL)
#: Period of the check whether to end a live measurement.
_TURN_S: Final = 0.2


class _TextFile(Protocol):
    def readline(self, size: int) -> str: ...
    def close(self) -> None: ...


class _Lines:
    """The lines of a log as python-can's readers take them, with the number of the last line.

    A last line without line end is left out: a cut line may look like a shorter frame.

    Attributes
    ----------
    number : int
        Number of the line that was returned last, from 1.
    is_cut : bool
        Whether the file ends inside the next line.
    is_error : bool
        Whether the line is an error frame of SocketCAN; python-can reads such a line as a frame of the bus.
    """

    def __init__(self, file: _TextFile) -> None:
        self._file = file
        self.text = ""
        self.number = 0
        self.is_cut = self.is_error = False

    def __iter__(self) -> Iterator[str]:
        return self

    def __next__(self) -> str:
        try:
            line = self._file.readline(_LINE_MAX)
        except EOFError:  # a compressed file that was cut
            line = "cut"
        if len(line) == _LINE_MAX:
            self.number += 1
            raise ValueError(f"more than {_LINE_MAX} characters")
        if not line.endswith("\n"):
            self.is_cut = not re.match(r"\s*(//|End\b|$)", line, re.IGNORECASE)
            raise StopIteration
        self.number += 1
        self.text = line
        error = _ERROR_FRAME.match(line)
        self.is_error = error is not None
        return line if error is None else f"{error[1]}{int(error[2], 16) & ~_ERROR_FLAG:08X}{error[3]}"

    def close(self) -> None:
        self._file.close()


class _Blf(can.BLFReader):
    """Reads as python-can does, and holds no more than `TEXT_BYTES_MAX` of unpacked bytes at once."""

    def __iter__(self) -> Generator[can.Message]:
        while head := self.file.read(blf.OBJ_HEADER_BASE_STRUCT.size):
            signature, _, _, size, kind = blf.OBJ_HEADER_BASE_STRUCT.unpack(head)
            if signature != b"LOBJ" or not len(head) <= size <= TEXT_BYTES_MAX:
                raise ValueError(f"a container of {size} bytes")
            content = self.file.read(size - len(head))
            self.file.read(size % 4)
            if kind == blf.LOG_CONTAINER:
                yield from self._parse_container(self._unpacked(content))
        self.stop()

    def _unpacked(self, content: bytes) -> bytes:
        method, _ = blf.LOG_CONTAINER_STRUCT.unpack_from(content)
        data, most = content[blf.LOG_CONTAINER_STRUCT.size :], TEXT_BYTES_MAX - len(self._tail)
        if method == blf.ZLIB_DEFLATE:
            data = zlib.decompressobj().decompress(data, most)
        if len(data) >= most:
            raise ValueError(f"expected at most {TEXT_BYTES_MAX} bytes unpacked, got more")
        if _ENDLESS.search(self._tail + data):
            raise ValueError("an object of no length")
        return data


def read_log(path: Path, warn: Callable[[str], None]) -> dict[str, Frames]:
    """Return the frames of a log by channel, in its order, with times in nanoseconds.

    A log that ends inside a line, as after a power failure, is read up to that line.
    InputError names the line of any other error.

    Parameters
    ----------
    path : pathlib.Path
        ``.mcap`` of ``skin record``, ``.log`` (candump -l), ``.asc``, ``.blf``, ``.trc``, ``.csv``, ``.db`` or, with
        asammdf installed, ``.mf4``. A log of candump may have any other suffix.
    warn : callable
        Receives one line of text if the log is cut.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such log")
    if is_recording(path):
        return _read_recording(path, warn)
    of_channel: dict[str, list[can.Message]] = {}
    lines: _Lines | None = None
    try:
        with _reader(path) as reader:
            if isinstance(reader, TextIOMessageReader):
                cast("TextIOWrapper", reader.file).reconfigure(encoding="utf-8", errors="replace")
                lines = reader.file = _Lines(reader.file)  # type: ignore[assignment]
            for message in _limited(reader, max(_FRAMES_MAX, path.stat().st_size // 2)):
                if lines is not None and lines.is_error:
                    message.is_error_frame, message.is_extended_id = True, False
                _check(message)
                of_channel.setdefault(str(message.channel), []).append(message)
    except Exception as error:  # the readers raise anything on a damaged file
        if lines is not None and _PRINTED.match(lines.text):
            raise InputError(
                f"{path}, line {lines.number}: expected a log, got what candump shows: record it with 'candump -l'"
            ) from error
        where = f"{path}, line {lines.number}" if lines is not None and lines.number else f"{path}"
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{where}: cannot be read as a log of CAN frames: {reason}") from error
    if lines is not None and lines.is_cut:
        warn(f"{path}: line {lines.number + 1} is cut off: read up to line {lines.number}")
    if not of_channel:
        raise InputError(f"{path}: holds no CAN frame")
    return {channel: to_logged_frames(messages) for channel, messages in of_channel.items()}


def _limited(messages: Iterable[can.Message], most: int) -> Iterator[can.Message]:
    for number, message in enumerate(messages):
        if number == most:
            raise ValueError(f"expected at most {most} frames in a file of this size, got more")
        yield message


def _reader(path: Path) -> MessageReader:
    """Return the reader of a log: by its suffix, or where no format has this suffix, that of candump by the content."""
    if path.suffix.lower() not in {*MESSAGE_READERS, ".gz"}:
        with path.open(encoding="utf-8", errors="replace") as file:
            first = next((line for line in iter(lambda: file.readline(_LINE_MAX), "") if line.strip()), "")
        if _LOGGED.match(first) or _PRINTED.match(first):
            return can.CanutilsLogReader(path)
    if path.suffix.lower() == ".blf":
        with ExitStack() as opened:
            blf_reader = _Blf(opened.enter_context(path.open("rb")))
            opened.pop_all()  # the reader closes what it can read
        return blf_reader
    reader = can.LogReader(path)
    if path.suffix.lower() == ".gz" and not isinstance(reader, TextIOMessageReader):
        raise ValueError("expected lines in a .gz")
    return reader


def _read_recording(path: Path, warn: Callable[[str], None]) -> dict[str, Frames]:
    """Return the frames of a recording by the name of their bus."""
    from recording.mcap_file import FRAMES, read_entries, wall_offset_ns

    parts: dict[str, list[Frames]] = {}
    offset_ns = wall_offset_ns(path)
    for entry in read_entries(path, warn):
        if entry.topic.startswith(FRAMES):
            part = from_bytes(entry.data, int(entry.about["data_bytes"]))
            part["time_ns"] += offset_ns
            parts.setdefault(entry.topic.removeprefix(FRAMES), []).append(part)
    if not parts:
        raise InputError(f"{path}: holds no CAN frame")
    return {name: np.concatenate(each) for name, each in parts.items()}


def _check(message: can.Message) -> None:
    """Refuse impossible frames, and set the length of a classic frame whose DLC is above 8."""
    longest = 64 if message.is_fd else 8
    if not 0 <= message.timestamp <= _LATEST_S:
        raise ValueError(f"a time of {message.timestamp:g} s")
    if not 0 <= message.arbitration_id <= EXTENDED_ID_MASK:
        raise ValueError(f"an identifier of {message.arbitration_id:X}h")
    if message.dlc < 0 or len(message.data) > longest:
        raise ValueError(f"a frame of {max(message.dlc, len(message.data))} bytes")
    message.dlc = min(message.dlc, longest)
    message.is_extended_id &= not message.is_error_frame  # of some formats alone


def listen(links: dict[int, Link], seconds: float, stopped: Callable[[], bool]) -> dict[int, Frames]:
    """Return the frames of every bus during `seconds`, or until `stopped`, by the number of its link."""
    arrived: dict[int, list[Frames]] = {number: [frames(0)] for number in links}
    until_s = time.monotonic() + seconds
    while (left_s := until_s - time.monotonic()) > 0 and not stopped():
        select.select(list(links.values()), [], [], min(left_s, _TURN_S))
        for number, link in links.items():
            seen = link.receive()
            arrived[number].append(seen[seen["flags"] & DISCARDED != DISCARDED])
    return {number: np.concatenate(seen) for number, seen in arrived.items()}


def of_buses(
    layout: Layout, names: list[str], logged: dict[str, Frames], path: Path, *, named_by_user: bool = False
) -> dict[int, Frames]:
    """Assign the channels of a log to the buses of a layout.

    Channels with one of `names` (one per bus) are assigned by name; if there is none, all are assigned in natural
    order. Raise InputError if channels are left over, or none has a name that the user gave.
    """
    named = {number: logged[name] for number, name in enumerate(names) if name in logged}
    if named:
        return named
    if named_by_user:
        raise InputError(f"{path}: expected a channel of {', '.join(names)}, the log holds {', '.join(logged)}")
    if len(logged) > len(layout.bus):
        raise InputError(
            f"{path}: expected up to {len(layout.bus)} channels, one per bus of the layout, got {', '.join(logged)}; "
            "name those of the skin with -c"
        )
    return {number: logged[name] for number, name in enumerate(sorted(logged, key=_natural))}


def _natural(name: str) -> list[tuple[int, str]]:
    """Sort key: can10 comes after can9."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", name)]
