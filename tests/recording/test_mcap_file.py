"""Recordings as files: what was flushed can be read, whatever became of the rest."""

import io
import re
from pathlib import Path

import msgspec
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from canskin.errors import InputError
from canskin.messages import LABEL
from recording.mcap_file import (
    EVENTS,
    File,
    RecordingWriter,
    message_decoder,
    newest_file,
    read_about,
    read_entries,
    read_topics,
    span_ns,
)

COUNT = 20


def written(path: Path, *, closes: bool = True) -> Path:
    """Write `COUNT` messages, each flushed."""
    writer = RecordingWriter(path, {"skin": "palm"}, [File("layout.toml", "application/toml", b"x = 1")], 5)
    writer.add_topic("frames/left", "canskin-frames", {"data_bytes": "8"})
    for place in range(COUNT):
        writer.add("frames/left", 1_000_000_000 + place, bytes([place]) * 1000)
        writer.flush()
    if closes:
        writer.close()
    else:
        writer.abandon()
    return path


def read(path: Path) -> tuple[list[bytes], list[str]]:
    said: list[str] = []
    return [entry.data for entry in read_entries(path, said.append)], said


def test_what_was_written_comes_back(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    writer = RecordingWriter(path, {"skin": "palm"}, [File("layout.toml", "application/toml", b"x = 1")], 5)
    writer.message(LABEL, 7, b"any bytes")
    writer.note(EVENTS, 8, {"text": "a bus is lost"})
    writer.close()
    first, second = read_entries(path, pytest.fail)
    assert (first.topic, first.time_ns, first.data, first.about) == ("label", 7, b"any bytes", {"message": "Label"})
    assert msgspec.json.decode(second.data) == {"text": "a bus is lost"}
    about = read_about(path)
    assert about.metadata == {"skin": "palm"}
    assert read_topics(path) == {"label", "events"}
    assert about.files == {"layout.toml": b"x = 1"}


def test_readers_of_others_find_index_and_messages(tmp_path: Path) -> None:
    reader = make_reader(io.BytesIO(written(tmp_path / "run.mcap").read_bytes()))
    summary = reader.get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == COUNT
    assert [each.topic for each in summary.channels.values()] == ["frames/left"]
    late = reader.iter_messages(starting_at=1_000_000_000 + COUNT - 2)
    assert [message.data[0] for _, _, message in late] == [COUNT - 2, COUNT - 1]


@pytest.mark.parametrize("closes", [True, False])
def test_what_comes_from_a_time_on_is_read_alone(tmp_path: Path, *, closes: bool) -> None:
    path = written(tmp_path / "run.mcap", closes=closes)
    assert span_ns(path) == (1_000_000_000, 1_000_000_000 + COUNT - 1)
    late = [entry.data[0] for entry in read_entries(path, lambda _: None, 1_000_000_000 + 17)]
    assert late[-3:] == [17, 18, 19]
    assert len(late) == (3 if closes else COUNT)  # without an index all of the file is read


def test_a_recording_without_messages_has_no_span(tmp_path: Path) -> None:
    RecordingWriter(tmp_path / "run.mcap", {}, [], 0).close()
    with pytest.raises(InputError, match="has no messages"):
        span_ns(tmp_path / "run.mcap")


def test_a_file_without_end_holds_all_that_was_flushed(tmp_path: Path) -> None:
    path = written(tmp_path / "run.mcap", closes=False)
    data, said = read(path)
    assert len(data) == COUNT
    assert read_topics(path) == {"frames/left"}
    assert "has no end" in said[0]


def test_a_file_cut_anywhere_is_readable_up_to_the_cut(tmp_path: Path) -> None:
    whole = written(tmp_path / "run.mcap").read_bytes()
    cut, found = tmp_path / "cut.mcap", []
    for size in range(300, len(whole), 61):
        cut.write_bytes(whole[:size])
        data, said = read(cut)
        assert data == [bytes([place]) * 1000 for place in range(len(data))]
        assert len(said) == 1
        found.append(len(data))
    assert found == sorted(found)
    assert found[-1] == COUNT


def of_chunks(path: Path, *, closes: bool = True) -> list[int]:
    """Write four messages in a chunk each; return where the compressed data of each chunk begin."""
    writer = RecordingWriter(path, {}, [], 0)
    for place in range(4):
        writer.message(LABEL, 1_000_000_000 * (place + 1), bytes([place]) * 1000)
        writer.flush()
    writer.close() if closes else writer.abandon()
    return [found.start() for found in re.finditer(re.escape(b"\x28\xb5\x2f\xfd"), path.read_bytes())]


def damage(path: Path, begin: int, end: int) -> None:
    content = bytearray(path.read_bytes())
    content[begin:end] = bytes(each ^ 0x55 for each in content[begin:end])
    path.write_bytes(content)


@pytest.mark.parametrize("number", [0, 1])
@pytest.mark.parametrize("part", [(12, 13), (-60, -20)], ids=["data", "times, sizes and length"])
def test_a_damaged_chunk_of_a_closed_file_is_left_out_and_named(
    tmp_path: Path, number: int, part: tuple[int, int]
) -> None:
    path = tmp_path / "run.mcap"
    begin = of_chunks(path)[number]
    damage(path, begin + part[0], begin + part[1])
    data, said = read(path)
    assert [each[0] for each in data] == [place for place in range(4) if place != number]
    assert said == [f"{path}: is damaged: the 0.0 s from {number:.1f} s on are missing"]


def test_what_comes_after_the_end_is_named(tmp_path: Path) -> None:
    path = written(tmp_path / "run.mcap")
    path.write_bytes(2 * path.read_bytes())
    data, said = read(path)
    assert len(data) == COUNT
    assert said == [f"{path}: is damaged: more comes after its end, as of two files in one, which is not read"]


@pytest.mark.parametrize("closes", [True, False])
def test_a_damaged_attachment_is_named_and_no_attachment(tmp_path: Path, closes: bool) -> None:
    path = written(tmp_path / "run.mcap", closes=closes)
    assert newest_file(path, "layout.toml") == b"x = 1"
    begin = path.read_bytes().index(b"x = 1")
    damage(path, begin, begin + 1)
    assert read_about(path).files == {}
    with pytest.raises(InputError, match=r"the newest 'layout\.toml' in this recording is damaged"):
        newest_file(path, "layout.toml")
    data, said = read(path)
    assert len(data) == COUNT
    assert f"{path}: is damaged: its file 'layout.toml' is left out" in said


@pytest.mark.parametrize("closes", [True, False])
def test_an_older_attachment_does_not_stand_for_a_damaged_newer_one(tmp_path: Path, closes: bool) -> None:
    path = tmp_path / "run.mcap"
    writer = RecordingWriter(path, {}, [File("zero.json", "application/json", b"first")], 5)
    writer.attach(File("zero.json", "application/json", b"second"), 6)
    writer.flush()
    if closes:
        writer.close()
    else:
        writer.abandon()
    assert newest_file(path, "zero.json") == b"second"
    begin = path.read_bytes().index(b"second")
    damage(path, begin, begin + 1)
    with pytest.raises(InputError, match=r"zero\.json"):
        newest_file(path, "zero.json")
    assert read_about(path).files == {"zero.json": b"first"}


def test_a_file_without_end_whose_topics_are_damaged_says_how_much_is_missing(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    begin = of_chunks(path, closes=False)[0]
    damage(path, begin + 12, begin + 13)
    data, said = read(path)
    assert data == []
    assert said == [
        f"{path}: is damaged: the 0.0 s from 0.0 s on are missing",
        f"{path}: has no end, as after a crash or on a full disk: read up to its cut, 3.0 s",
        f"{path}: is damaged: 3 messages are missing whose topics were named in the damaged part",
    ]


def test_a_file_whose_chunk_and_index_are_damaged_is_read_up_to_there(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    begin = of_chunks(path)[1]
    damage(path, begin - 60, begin - 20)
    damage(path, path.stat().st_size - 30, path.stat().st_size - 10)
    data, said = read(path)
    assert [each[0] for each in data] == [0]
    assert said == [f"{path}: is damaged: read up to its cut, 0.0 s"]


@pytest.mark.parametrize("content", [b"\xc1", b"\x81\xa5label\xa1\xff", b"\x81\xa5other" + 100_000 * b"\x91" + b"\0"])
def test_a_message_that_cannot_be_decoded_is_one_line(tmp_path: Path, content: bytes) -> None:
    with pytest.raises(InputError, match=r"run.mcap: a message of 'label' cannot be decoded"):
        message_decoder(tmp_path / "run.mcap", LABEL)(content)


def test_other_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "other.mcap"
    path.write_bytes(b"no magic here")
    with pytest.raises(InputError, match="is no MCAP file"):
        read_about(path)
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        writer.finish()
    with pytest.raises(InputError, match="is no recording of a skin"):
        list(read_entries(path, pytest.fail))
    with pytest.raises(InputError, match="cannot be read: No such file"):
        read_about(tmp_path / "none.mcap")
