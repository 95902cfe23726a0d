"""Where a recorder writes: an MCAP file, or a log of frames in any format of python-can."""

import contextlib
import platform
import sqlite3
import time
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from bus.messages import CANDUMP_ERROR, to_message
from canskin.errors import InputError
from canskin.messages import Topic
from dbc.contract import Contract
from dbc.frame import CLASSIC_BYTES, ERROR, FD, FD_BYTES, REMOTE, Frames, frames
from dbc.generate import contract_files
from dbc.stored_frames import RECORD_TEXT, to_bytes
from recording import RECORDING_SUFFIX, is_recording
from recording.mcap_file import FINGERPRINT, FRAMES, LAYOUT_FILE, RECORDING, WALL_OFFSET_NS, File, RecordingWriter
from skin.layout import Layout, layout_text

if TYPE_CHECKING:
    import can

#: Formats of python-can that do not keep the channel of a frame.
WITHOUT_CHANNELS: Final = (".csv", ".db")
#: Flags of the frames that a format of python-can does not hold.
_NOT_HELD: Final = {".csv": FD, ".db": FD, ".trc": FD | ERROR | REMOTE}
#: The format that python-can's own writer does not write to its end.
_DATABASE: Final = ".db"
#: The format whose channels have names; the others number them.
_NAMED: Final = ".log"
#: Time that frames of several buses wait for each other: a log has its frames in the order of time.
_ORDER_NS: Final = 100_000_000
#: Libraries whose versions a recording names.
_LIBRARIES: Final = ("canskin", "eclipse-zenoh", "python-can", "numpy", "mcap")


class McapSink(RecordingWriter):
    """Writes frames and messages to an MCAP file, see `Sink`.

    Parameters
    ----------
    recording : str
        See `recording.mcap_file.RECORDING`; default: name of the skin and time.
    path, part
        As of `RecordingWriter`.
    """

    has_messages = True

    def __init__(
        self,
        path: Path | RecordingWriter,
        contract: Contract,
        now_ns: int,
        offset_ns: int,
        recording: str = "",
        *,
        part: str = "",
    ) -> None:
        layout = contract.layout
        metadata = {
            "skin": layout.name,
            RECORDING: recording or f"{layout.name}-{datetime.fromtimestamp(now_ns * 1e-9, UTC):%Y%m%dT%H%M%S.%f}Z",
            FINGERPRINT: contract.phi.fingerprint,
            WALL_OFFSET_NS: str(offset_ns),
            "python": platform.python_version(),
            "platform": platform.platform(),
            **{name: version(name) for name in _LIBRARIES},
        }
        files = [File(LAYOUT_FILE, "application/toml", layout_text(layout).encode())]
        files += [File(name, "text/plain", text.encode()) for name, text in contract_files(contract).items()]
        super().__init__(path, metadata, files, now_ns, part)
        self._topics = [FRAMES + bus.name for bus in layout.bus]
        self._data_bytes = [FD_BYTES if bus.fd else CLASSIC_BYTES for bus in layout.bus]
        for number, bus in enumerate(layout.bus):
            about = {
                "bus": str(number),
                "bitrate": str(bus.bitrate),
                "data_bytes": str(self._data_bytes[number]),
                "record": RECORD_TEXT,
            }
            self.add_topic(self._topics[number], "canskin-frames", about)

    def frames(self, bus: int, arrived: Frames, now_ns: int, _offset_ns: int) -> int:
        """Add the frames of a bus; return their number."""
        self.add(self._topics[bus], now_ns, to_bytes(arrived, self._data_bytes[bus]))
        return len(arrived)


class _Database:
    """Writes SQLite as python-can reads it, in the caller's thread: python-can's own writer loses rows at its end."""

    def __init__(self, path: Path) -> None:
        with self._failing():
            self._rows = sqlite3.connect(path)
            columns = "ts REAL, arbitration_id INTEGER, extended INTEGER, remote INTEGER, error INTEGER, dlc INTEGER"
            self._rows.execute(f"CREATE TABLE messages ({columns}, data BLOB)")

    def on_message_received(self, message: "can.Message") -> None:
        """Add a row."""
        flags = message.is_extended_id, message.is_remote_frame, message.is_error_frame
        row = message.timestamp, message.arbitration_id, *flags, message.dlc, bytes(message.data)
        with self._failing():
            self._rows.execute("INSERT INTO messages VALUES (?, ?, ?, ?, ?, ?, ?)", row)

    def flush(self) -> None:
        """Make all rows readable."""
        with self._failing():
            self._rows.commit()

    def stop(self) -> None:
        """Write the last rows, and close the file."""
        with contextlib.closing(self._rows):
            self.flush()

    @contextlib.contextmanager
    def _failing(self) -> Iterator[None]:
        try:
            yield
        except sqlite3.Error as error:
            raise OSError(f"SQLite: {error}") from error


class LogSink:
    """Writes frames alone, in the format of python-can that the suffix names; messages are left out. See `Sink`."""

    has_messages = False

    def __init__(self, path: Path, layout: Layout) -> None:
        import can

        suffix = path.suffix.lower()
        self._log: Any = _Database(path) if suffix == _DATABASE else can.Logger(path)
        self._is_named = suffix == _NAMED
        self._not_held = _NOT_HELD.get(suffix, 0)
        self._channels = [bus.name if self._is_named else str(number) for number, bus in enumerate(layout.bus)]
        self._waiting = frames(0)
        self._offset_ns = 0

    def frames(self, bus: int, arrived: Frames, _now_ns: int, offset_ns: int) -> int:
        """Add the frames of a bus that the format holds; return their number."""
        arrived = arrived[arrived["flags"] & self._not_held == 0]
        arrived["port"] = bus
        self._waiting = np.concatenate((self._waiting, arrived))
        self._offset_ns = offset_ns
        return len(arrived)

    def message(self, topic: Topic, now_ns: int, content: bytes) -> None:
        """Leave the message out."""

    def note(self, topic: str, now_ns: int, values: Mapping[str, Any]) -> None:
        """Leave the note out."""

    def attach(self, file: File, now_ns: int) -> None:
        """Leave the file out."""

    def flush(self) -> None:
        """Make readable what was added: the frames that no other bus can precede."""
        if len(self._waiting):
            self._write(int(self._waiting["time_ns"].max()) - _ORDER_NS)
        getattr(self._log, "_flush", lambda: None)()  # BLF is written in containers
        getattr(self._log, "file", self._log).flush()

    def close(self) -> None:
        """Write the last frames and the end of the log."""
        self._write(np.iinfo(np.int64).max)
        self._log.stop()

    def abandon(self) -> None:
        """Close a log that cannot be written any more."""
        with contextlib.suppress(OSError, ValueError):
            self._log.stop()

    def _write(self, until_ns: int) -> None:
        is_due = self._waiting["time_ns"] <= until_ns
        due, self._waiting = self._waiting[is_due], self._waiting[~is_due]
        for place in np.argsort(due["time_ns"], kind="stable"):
            record = due[place]
            message = to_message(record, self._channels[record["port"]], self._offset_ns)
            if self._is_named and message.is_error_frame:  # python-can would write every error as the same
                message.is_error_frame, message.is_extended_id = False, True
                message.arbitration_id |= CANDUMP_ERROR
            self._log.on_message_received(message)


#: Where a recorder writes. Every method raises OSError if the file cannot be written. `now_ns` is the wall clock, and
#: `offset_ns` the wall clock minus CLOCK_MONOTONIC. `has_messages`: messages of the fabric are written, too.
Sink = McapSink | LogSink


def open_sink(path: Path, contract: Contract, now_ns: int, offset_ns: int) -> Sink:
    """Open a new file in the format that its suffix names, see `check_format`.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    if is_recording(path):
        return McapSink(path, contract, now_ns, offset_ns)
    try:
        return LogSink(path, contract.layout)
    except (ImportError, NotImplementedError) as error:  # asammdf is not installed
        raise InputError(f"{path}: python-can cannot write {path.suffix} here: {error}") from error


def open_sinks(path: Path, contracts: Sequence[Contract]) -> Sequence[Sink]:
    """Open a new file for several skins, a recording; of one skin see `open_sink`.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    now_ns = time.time_ns()
    offset_ns, first, *others = now_ns - time.monotonic_ns(), *contracts
    if not others:
        return [open_sink(path, first, now_ns, offset_ns)]
    sink = McapSink(path, first, now_ns, offset_ns, part=first.layout.name)
    return [sink, *(McapSink(sink, each, now_ns, offset_ns, part=each.layout.name) for each in others)]


def check_format(path: Path, layout: Layout | None = None) -> None:
    """Check that `path` names a format, and that a log of this format holds the frames of all buses of a layout."""
    if is_recording(path):
        return
    from can.io.logger import MESSAGE_WRITERS

    suffix = path.suffix.lower()
    if suffix not in MESSAGE_WRITERS:
        raise InputError(
            f"{path}: expected a file that ends in {RECORDING_SUFFIX}, or, for frames alone, in one of "
            f"{', '.join(sorted(MESSAGE_WRITERS))}"
        )
    if layout is None:
        return
    buses = len(layout.bus)
    if suffix in WITHOUT_CHANNELS and buses > 1:
        raise InputError(f"{path}: a {suffix} log does not tell the buses apart, this skin has {buses}: choose another")
    if _NOT_HELD.get(suffix, 0) & FD and any(bus.fd for bus in layout.bus):
        raise InputError(f"{path}: a {suffix} log does not hold CAN FD, which this skin has: choose another")
