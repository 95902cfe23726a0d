"""Recordings: MCAP files (https://mcap.dev) with the frames of the buses and the messages of the fabric.

A recording has one topic per bus, ``frames/NAME``, whose messages hold many frames each (`dbc.stored_frames`), and the
topics of `canskin.messages`, whose messages are those of the fabric, byte for byte: msgpack. Of the topics `EVENTS` and
`RECORDER` each message is a JSON object. The file begins with metadata and attachments.

In a recording of several skins the names of topics, metadata and attachments begin with the name of their skin:
``palm/image``. Whoever reads gives the path of one of the skins, ``run.mcap/palm``.
"""

import contextlib
import io
import os
import struct
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO, Final, NamedTuple

import lz4.frame
import msgspec
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.records import Attachment, Channel, Chunk, ChunkIndex, Header, Message, Metadata
from mcap.stream_reader import MAGIC_SIZE, StreamReader, breakup_chunk
from mcap.summary import Summary
from mcap.writer import Writer

from canskin.errors import UNDECODABLE, InputError, reasoned
from canskin.messages import Topic
from recording import file_of, is_recording

#: Profile in the header: what the topics and messages are.
PROFILE: Final = "canskin"
#: Name of the metadata record, and of the attachment with the layout.
METADATA: Final = "canskin"
LAYOUT_FILE: Final = "layout.toml"
#: Attachment with the calibration of the gateway (`skin.calibration_file`), again after each change.
CALIBRATION_FILE: Final = "calibration.json"
FRAMES: Final = "frames/"
#: Key of the metadata: wall clock minus CLOCK_MONOTONIC at the beginning, nanoseconds.
WALL_OFFSET_NS: Final = "wall_offset_ns"
#: Key of the metadata: fingerprint of the Φ of the skin.
FINGERPRINT: Final = "fingerprint"
#: Key of the metadata: what distinguishes the run from all others; the same in all that is made of the run.
RECORDING: Final = "recording"
#: What happened: services that came and went, buses that were lost.
EVENTS: Final = "events"
#: The recorder's own counters.
RECORDER: Final = "recorder"

#: Size at which a chunk is compressed and written; `RecordingWriter.flush` writes smaller ones.
_CHUNK_BYTES: Final = 1 << 20
#: A longer record is damage: a layout and a calibration are shorter.
_LONGEST_RECORD: Final = 1 << 25
#: Most bytes of a message; those of the fabric take less.
LONGEST_MESSAGE: Final = 1 << 22
#: Most bytes that a chunk unpacks to: many times `_CHUNK_BYTES`, and more than `LONGEST_MESSAGE`.
_UNPACKED_BYTES_MAX: Final = 1 << 23
#: An attachment ends with its CRC-32.
_CRC_BYTES: Final = 4
#: Errors of the library for files that are cut or damaged.
_DAMAGE: Final = (
    McapError,
    zstandard.ZstdError,
    struct.error,
    ValueError,
    OverflowError,
    IndexError,
    KeyError,
    TypeError,
    MemoryError,
)
#: Receives a line of text for each part of a file that is missing or damaged; all other parts are read.
Warn = Callable[[str], None]


class Gap(NamedTuple):
    """Part of a recording that cannot be read: all from there on if `is_rest`, else messages of these times."""

    first_ns: int
    last_ns: int
    is_rest: bool
    has_end: bool


class Damage(NamedTuple):
    """What else is wrong with a recording; `file` is the name of an attachment that is damaged."""

    text: str
    file: str = ""


class File(NamedTuple):
    """An attachment."""

    name: str
    media_type: str
    content: bytes


class Entry(NamedTuple):
    """One message of a recording; `time_ns` is the wall clock of the recorder, `about` describes the topic."""

    topic: str
    time_ns: int
    data: bytes
    about: Mapping[str, str]


class About(NamedTuple):
    """What a recording says of itself."""

    metadata: Mapping[str, str]
    files: Mapping[str, bytes]


class _Opened(NamedTuple):
    """A new file, what writes records into the file, and a thread that has them brought to the disk."""

    file: BinaryIO
    writer: Writer
    disk: ThreadPoolExecutor


class RecordingWriter:
    """Writes a recording. After `flush` all that was added before is readable, whatever happens to this process.

    Parameters
    ----------
    path : pathlib.Path or RecordingWriter
        A new file; or what writes another skin into the same file: one thread closes all of them.
    files : sequence of File
        Attachments.
    part : str
        Of a recording of several skins, the name of the skin that is written.

    Raises
    ------
    OSError
        From every method, if the file cannot be written.
    """

    def __init__(
        self,
        path: "Path | RecordingWriter",
        metadata: Mapping[str, str],
        files: Sequence[File],
        time_ns: int,
        part: str = "",
    ) -> None:
        self._prefix = f"{part}/" if part else ""
        self._channels: dict[str, int] = {}
        self._synced: Future[None] | None = None
        self.opened: _Opened = _open(path) if isinstance(path, Path) else path.opened
        self._file, self._writer, self._disk = self.opened
        self._writer.add_metadata(self._prefix + METADATA, dict(metadata))
        for each in files:
            self.attach(each, time_ns)
        self.flush()

    def attach(self, file: File, time_ns: int) -> None:
        """Attach a file; of several of one name the newest counts."""
        self._writer.add_attachment(time_ns, time_ns, self._prefix + file.name, file.media_type, file.content)

    def add_topic(self, name: str, encoding: str, about: Mapping[str, str]) -> None:
        """Describe a topic before its first message."""
        self._channels[name] = self._writer.register_channel(self._prefix + name, encoding, 0, dict(about))

    def add(self, topic: str, time_ns: int, data: bytes) -> None:
        """Add a message; `time_ns` is the wall clock."""
        self._writer.add_message(self._channels[topic], time_ns, data, time_ns)

    def message(self, topic: Topic, time_ns: int, data: bytes) -> None:
        """Add a message of the fabric, as it was published."""
        if topic.name not in self._channels:
            self.add_topic(topic.name, "msgpack", {"message": topic.message.__name__})
        self.add(topic.name, time_ns, data)

    def note(self, topic: str, time_ns: int, values: Mapping[str, Any]) -> None:
        """Add a JSON object."""
        if topic not in self._channels:
            self.add_topic(topic, "json", {})
        self.add(topic, time_ns, msgspec.json.encode(values))

    def flush(self) -> None:
        """Give all to the system, and have it brought to the disk meanwhile."""
        self._writer.flush()
        if self._synced is None or self._synced.done():
            if self._synced is not None:
                self._synced.result()
            self._synced = self._disk.submit(os.fdatasync, self._file.fileno())

    def close(self) -> None:
        """Write the index and close the file, unless another skin's writer has."""
        if self._file.closed:
            return
        try:
            self._writer.finish()
            self._file.flush()
        finally:
            self.abandon()

    def abandon(self) -> None:
        """Close the file without an index: what was flushed is readable."""
        self._disk.shutdown()
        with contextlib.suppress(OSError):
            self._file.close()


def _open(path: Path) -> _Opened:
    """Open a new file."""
    file = path.open("xb")
    writer = Writer(file, chunk_size=_CHUNK_BYTES)
    writer.start(PROFILE)
    return _Opened(file, writer, ThreadPoolExecutor(1, "fdatasync"))


def read_about(path: Path) -> About:
    """Return what a recording says of itself; InputError for several skins of which `path` names none."""
    about = About({}, {})
    for record in _records(path):
        if isinstance(record, Metadata) and _own(record.name, path) == METADATA:
            about = about._replace(metadata=record.metadata)
        elif isinstance(record, Attachment) and (name := _own(record.name, path)):
            about = about._replace(files={**about.files, name: record.data})
        elif isinstance(record, Message):
            break
    if not about.metadata:
        part_of(path, None)
    return about


def parts_of(path: Path) -> dict[str, Path]:
    """Return the skins of a recording by name, each as the path that readers take."""
    found, file = {}, file_of(path)
    for record in _records(file):
        if isinstance(record, Metadata) and record.name == METADATA:
            found[record.metadata.get("skin", "")] = file
        elif isinstance(record, Metadata) and record.name.endswith(f"/{METADATA}"):
            name = record.name.removesuffix(f"/{METADATA}")
            found[name] = file / name
        elif isinstance(record, Message):
            break
    return found


def part_of(path: Path, skin: str | None) -> Path:
    """Return the skin of this name of a recording, as the path that readers take; without a name the path itself.

    Raise InputError if the recording has no such skin, or several, of which none is named.
    """
    if skin is None and not is_recording(path):
        return path
    parts = parts_of(path)
    names = f"the skin{'s' * (len(parts) > 1)} {', '.join(map(repr, parts))}"
    if skin is not None and skin not in parts:
        raise InputError(f"{path}: has no skin '{skin}', but {names}")
    if skin is None and parts and path not in parts.values():
        some = next(iter(parts.values()))
        raise InputError(f"{file_of(path)}: has {names}: give --skin NAME, or {some} as its path")
    return path if skin is None else parts[skin]


def _own(name: str, path: Path) -> str:
    """Return a name of a recording as it is without its skin's; empty if the name is of another skin."""
    prefix = "" if file_of(path) == path else f"{path.name}/"
    return name.removeprefix(prefix) if name.startswith(prefix) else ""


def newest_file(path: Path, name: str) -> bytes | None:
    """Return the newest attachment of a name, wherever in the recording it is; None without.

    Raise InputError if the newest is damaged, though an older one is whole.
    """
    read_about(path)
    found: bytes | None = None
    is_damaged = False
    with _opened(path) as file, contextlib.suppress(*_DAMAGE):
        if _summary(file).attachment_indexes:
            file.seek(0)
            for record in make_reader(file).iter_attachments():
                if _own(record.name, path) == name:
                    found, is_damaged = record.data, not _is_whole(record, file)
            return _sound(path, name, found, is_damaged)
    for record in _records(path):  # without an index, as after a crash
        if isinstance(record, Attachment) and _own(record.name, path) == name:
            found, is_damaged = record.data, False
        elif isinstance(record, Damage) and _own(record.file, path) == name:
            is_damaged = True
    return _sound(path, name, found, is_damaged)


def _sound(path: Path, name: str, found: bytes | None, is_damaged: bool) -> bytes | None:
    if is_damaged:
        raise InputError(f"{path}: the newest '{name}' in this recording is damaged: give the file itself")
    return found


def wall_offset_ns(path: Path) -> int:
    """Return wall clock minus the clock of the frames and messages of a recording."""
    return int(read_about(path).metadata.get(WALL_OFFSET_NS, 0))


def recording_id(path: Path) -> str:
    """Return what distinguishes a recorded run from others; of a log, or an older recording, the name of the file."""
    if not is_recording(path):
        return path.stem
    return read_about(path).metadata.get(RECORDING) or path.stem


class Read(NamedTuple):
    """A decoded message of a recording: its topic, the recorder's wall clock, and the message."""

    topic: Topic
    time_ns: int
    message: Any


def read_messages(path: Path, topics: Iterable[Topic], warn: Warn, from_ns: int = 0) -> Iterator[Read]:
    """Yield the messages of some topics of a recording in the order of the file, from a time on.

    Raise InputError at a message that does not fit its topic.
    """
    wanted = {topic.name: (topic, message_decoder(path, topic)) for topic in topics}
    for entry in read_entries(path, warn, from_ns):
        if entry.topic in wanted and entry.time_ns >= from_ns:
            topic, decode = wanted[entry.topic]
            yield Read(topic, entry.time_ns, decode(entry.data))


def read_few(path: Path, topic: Topic) -> Iterator[Read]:
    """Yield the messages of a topic that has few, without the parts of the file that have none; none without an index.

    Raise InputError at a message that does not fit its topic.
    """
    decode = message_decoder(path, topic)
    with _opened(path) as file:
        summary = _summary(file)
        channels = {number for number, each in summary.channels.items() if _own(each.topic, path) == topic.name}
        for index in _in_order(summary):
            if not channels.isdisjoint(index.message_index_offsets):
                for each in _indexed_chunk(file, index):
                    if isinstance(each, Message) and each.channel_id in channels:
                        yield Read(topic, each.log_time, decode(each.data))


def message_decoder(path: Path, topic: Topic) -> Callable[[bytes], Any]:
    """Return what decodes the messages of a topic of a recording; it raises InputError for one that does not fit."""
    decode = topic.decoder()

    def decoded(data: bytes) -> Any:
        try:
            return decode(data)
        except UNDECODABLE as error:
            what = f"a message of '{topic.name}' cannot be decoded"
            raise InputError(f"{path}: {what}, it is of another version of canskin or damaged: {error}") from error

    return decoded


def read_entries(path: Path, warn: Warn, from_ns: int = 0) -> Iterator[Entry]:
    """Yield the messages of a recording in the order of the file; with an index, without most before a time."""
    part_of(path, None)
    channels: Mapping[int, Channel] = {}
    first_ns = last_ns = unknown = 0
    for record in _records_from(path, from_ns) if from_ns > 0 else _records(path):
        if isinstance(record, Channel):
            channels = {**channels, record.id: replace(record, topic=_own(record.topic, path))}
        elif isinstance(record, Message):
            first_ns, last_ns = first_ns or record.log_time, record.log_time
            channel = channels.get(record.channel_id)
            if channel is None:
                unknown += 1
            elif channel.topic:
                yield Entry(channel.topic, record.log_time, record.data, channel.metadata)
        elif isinstance(record, Gap) and record.is_rest:
            what = "is damaged" if record.has_end else "has no end, as after a crash or on a full disk"
            warn(f"{path}: {what}: read up to its cut, {(last_ns - first_ns) * 1e-9:.1f} s")
        elif isinstance(record, Gap):
            first_ns, last_ns = first_ns or record.first_ns, max(last_ns, record.last_ns)
            begin_s, length_s = (record.first_ns - first_ns) * 1e-9, (record.last_ns - record.first_ns) * 1e-9
            warn(f"{path}: is damaged: the {length_s:.1f} s from {begin_s:.1f} s on are missing")
            channels = {**_indexed_channels(path), **channels}
        elif isinstance(record, Damage):
            warn(f"{path}: is damaged: {record.text}")
    if unknown:
        warn(f"{path}: is damaged: {unknown} messages are missing whose topics were named in the damaged part")


def _indexed_channels(path: Path) -> Mapping[int, Channel]:
    """Return the topics in the index of a recording by number; none without an index."""
    with _opened(path) as file:
        return {number: replace(each, topic=_own(each.topic, path)) for number, each in _summary(file).channels.items()}


def read_topics(path: Path) -> set[str]:
    """Return the topics of which a recording has messages."""
    read_about(path)
    with _opened(path) as file, contextlib.suppress(*_DAMAGE):
        summary = _summary(file)
        if summary.statistics is not None:
            counts = summary.statistics.channel_message_counts
            topics = {_own(summary.channels[number].topic, path) for number, count in counts.items() if count}
            return topics - {""}
    return {entry.topic for entry in read_entries(path, lambda _: None)}


def span_ns(path: Path) -> tuple[int, int]:
    """Return the times of the first and the last message of a recording; InputError if it has none."""
    read_about(path)
    with _opened(path) as file:
        statistics = _summary(file).statistics
        if statistics is not None and statistics.message_count:
            return statistics.message_start_time, statistics.message_end_time
    times_ns = [entry.time_ns for entry in read_entries(path, lambda _: None)]
    if not times_ns:
        raise InputError(f"{path}: this recording has no messages")
    return min(times_ns), max(times_ns)


def _records_from(path: Path, from_ns: int) -> Iterator[Any]:
    """Yield records as `_records`; with an index, those of the chunks that end at a time or later."""
    with _opened(path) as file:
        summary = _summary(file)
        if not summary.chunk_indexes:
            yield from _records(path)
            return
        yield from summary.channels.values()
        yield from _indexed_records(file, sum(each.message_end_time < from_ns for each in _in_order(summary)[:-1]))


class _Bounded(io.BufferedReader):
    """A file of which no more than a record is read at once, whatever length is written in it."""

    def read(self, size: int | None = -1, /) -> bytes:
        """Return bytes; raise McapError for more than those of a record."""
        if size is None or not 0 <= size <= _LONGEST_RECORD:
            raise McapError(f"expected at most {_LONGEST_RECORD} bytes, got {size}")
        return super().read(size)


def _opened(path: Path) -> _Bounded:
    return _Bounded(io.FileIO(file_of(path)))


def _summary(file: BinaryIO) -> Summary:
    """Return the index of a recording; an empty one if the file has none, or a damaged one."""
    file.seek(0)
    with contextlib.suppress(*_DAMAGE):
        return make_reader(file).get_summary() or Summary()
    return Summary()


def _in_order(summary: Summary) -> list[ChunkIndex]:
    """Return the chunks of a recording in the order of the file; none without an index."""
    return sorted(summary.chunk_indexes, key=lambda each: each.chunk_start_offset)


def _records(path: Path) -> Iterator[Any]:
    """Yield the records of a file, and a `Gap` in the place of what is damaged or missing."""
    with reasoned(InputError, f"{path}: cannot be read"), _opened(path) as file:
        records = StreamReader(file, emit_chunks=True, validate_crcs=True, record_size_limit=_LONGEST_RECORD).records
        try:
            header = next(records)
        except (*_DAMAGE, StopIteration) as error:
            raise InputError(f"{path}: is no MCAP file: expected a recording of 'skin record'") from error
        if not isinstance(header, Header) or header.profile != PROFILE:
            raise InputError(f"{path}: is no recording of a skin: expected a file of 'skin record'")
        chunks = 0
        try:
            for record in records:
                chunks += isinstance(record, Chunk)
                if isinstance(record, Attachment) and not _is_whole(record, file):
                    yield Damage(f"its file '{record.name}' is left out", record.name)
                    continue
                yield from _records_of(record, path) if isinstance(record, Chunk) else (record,)
            if file.read(1):
                yield Damage("more comes after its end, as of two files in one, which is not read")
        except _DAMAGE:
            yield from _indexed_records(file, chunks)


def _is_whole(attachment: Attachment, file: BinaryIO) -> bool:
    """Check the CRC of an attachment that was just read, which the library writes and does not check; 0 is none."""
    file.seek(-_CRC_BYTES, os.SEEK_CUR)
    stored, expected = file.read(_CRC_BYTES), RecordBuilder()
    attachment.write(expected)
    return not any(stored) or bool(stored == expected.end()[-_CRC_BYTES:])


def _records_of(chunk: Chunk, path: object) -> list[Any]:
    """Return the records of a chunk, or the gap that a damaged chunk leaves; InputError if it unpacks to too much."""
    try:
        data, most = chunk.data, _UNPACKED_BYTES_MAX
        # Never more than the limit, whatever size the chunk and its frame claim.
        if chunk.compression == "zstd":
            data = zstandard.ZstdDecompressor(max_window_size=most).stream_reader(data).read(most + 1)
        elif chunk.compression == "lz4":
            data = lz4.frame.LZ4FrameDecompressor().decompress(data, most + 1)
        if (size := max(len(data), chunk.uncompressed_size)) > most:
            raise InputError(f"{path}: expected chunks of at most {most} bytes unpacked, got {size}")
        if len(data) != size:
            raise McapError(f"expected {size} bytes unpacked, got {len(data)}")
        return [*breakup_chunk(replace(chunk, compression="", data=data), validate_crc=True)]
    except _DAMAGE:
        return [Gap(chunk.message_start_time, chunk.message_end_time, is_rest=False, has_end=True)]


def _indexed_records(file: BinaryIO, chunks: int) -> Iterator[Any]:
    """Yield the records of all chunks after the first `chunks`, by the index of a closed file."""
    indexes = _in_order(_summary(file))
    if len(indexes) <= chunks:
        yield Gap(0, 0, is_rest=True, has_end=_has_end(file))
    for index in indexes[chunks:]:
        yield from _indexed_chunk(file, index)


def _indexed_chunk(file: BinaryIO, index: ChunkIndex) -> list[Any]:
    """Return the records of a chunk, or the gap that a damaged chunk leaves."""
    file.seek(index.chunk_start_offset)
    with contextlib.suppress(*_DAMAGE, StopIteration):
        record = next(StreamReader(file, True, True, record_size_limit=_LONGEST_RECORD).records)
        if isinstance(record, Chunk):
            return _records_of(record, file.name)
    return [Gap(index.message_start_time, index.message_end_time, is_rest=False, has_end=True)]


def _has_end(file: BinaryIO) -> bool:
    """Return whether a file was closed: an MCAP file begins and ends with the same bytes."""
    file.seek(0)
    magic = file.read(MAGIC_SIZE)
    file.seek(-MAGIC_SIZE, os.SEEK_END)
    return file.read(MAGIC_SIZE) == magic
