"""Logs that are odd, damaged, or of clocks that were set: read whole, or what is missing is said with its place."""

import gzip
import zlib
from pathlib import Path

import can
import numpy as np
import pytest

from bandwidth.logs import read_log
from canskin.errors import InputError
from dbc.frame import BRS, ERROR, EXTENDED, FD, REMOTE, Frames, frames
from recording.sinks import open_sink
from tests.bandwidth.log_corpus import ASC, CORPUS, blf_file, blf_frame, blf_object
from tests.layouts import small_contract

FD_ESI_BRS = FD | BRS | 0x20


def read(path: Path, content: bytes) -> tuple[dict[str, Frames], list[str]]:
    path.write_bytes(content)
    said: list[str] = []
    return read_log(path, lambda line: said.append(line.removeprefix(f"{path}"))), said


@pytest.mark.parametrize(
    ("name", "flags", "says"),
    [
        (
            "candump.log",
            {"can0": [0, 0, REMOTE, REMOTE, FD_ESI_BRS, ERROR, ERROR, EXTENDED]},
            [": not read: line 9: expected a frame of CAN or CAN FD, or a comment"],
        ),
        ("absolute.asc", {"0": [0, 0, ERROR, FD | BRS], "1": [EXTENDED | REMOTE]}, []),
        ("relative.asc", {"0": [0, 0, ERROR, FD | BRS], "1": [EXTENDED | REMOTE]}, []),
        ("errors-1-1.trc", {"1": [0, ERROR, EXTENDED | REMOTE]}, []),
        ("errors-1-3.trc", {"1": [0], "2": [ERROR]}, []),
        (
            "errors-2-1.trc",
            {"1": [0, ERROR, FD | BRS, REMOTE]},
            [": not read: line 10: expected a frame of CAN or CAN FD, or a comment"],
        ),
        ("kinds.blf", {"0": [0, ERROR, ERROR, ERROR]}, [": not read: objects of kinds 4 (1), 96 (1)"]),
    ],
)
def test_frames_of_every_kind_are_read_or_named(
    tmp_path: Path, name: str, flags: dict[str, list[int]], says: list[str]
) -> None:
    found, said = read(tmp_path / name, CORPUS[name])
    assert {channel: seen["flags"].tolist() for channel, seen in found.items()} == flags
    assert said == says


@pytest.mark.parametrize("first", [b"base hex  no internal events logged\n", b"base dec\n// a comment\n", b""])
def test_an_asc_may_have_a_short_header_or_none(tmp_path: Path, first: bytes) -> None:
    lines = b"".join(b"0.%d 1 385 Rx d 1 10\n" % number for number in range(3))
    found, said = read(tmp_path / "a.asc", first + lines)
    assert found["0"]["can_id"].tolist() == 3 * [385 if b"dec" in first else 0x385]
    assert said == []


def test_lengths_are_those_of_the_frames(tmp_path: Path) -> None:
    """The raw DLC B of a classic frame is 8 bytes, the DLC 9 of a frame of CAN FD is 12."""
    found, _ = read(tmp_path / "a.log", CORPUS["candump.log"])
    assert found["can0"]["length"].tolist()[:5] == [8, 8, 8, 5, 2]
    assert found["can0"]["can_id"].tolist() == [0x181, 0x314, 0x315, 0x316, 0x317, 0x88, 0xC, 0x1ABCDEF]
    assert bytes(found["can0"]["data"][1, :8]).hex() == "1122334455667788"
    found, _ = read(tmp_path / "a.trc", CORPUS["errors-2-1.trc"])
    assert found["1"]["length"].tolist()[2] == 12


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
@pytest.mark.parametrize(
    "name", ["candump.log", "candump.txt", "candump.log.gz", "absolute.asc", "errors-2-1.trc", "of.2026.trc.gz"]
)
def test_marks_of_the_encoding_are_understood(tmp_path: Path, name: str, encoding: str) -> None:
    plain = CORPUS[name.replace(".gz", "").replace(".txt", ".log").replace("of.2026", "errors-2-1")]
    content = plain.decode().removeprefix("# a comment\n; another\n").encode(encoding)
    found, _ = read(tmp_path / name, gzip.compress(content) if name.endswith(".gz") else content)
    (tmp_path / "other").mkdir()
    plainly, _ = read(tmp_path / "other" / name.replace(".gz", ""), plain)
    assert {name: seen.tobytes() for name, seen in found.items()} == {
        name: seen.tobytes() for name, seen in plainly.items()
    }


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("a.log", b"(1.0) can0 181#01\n" + bytes(20) + b"(1.2) can0 181#01\n", "line 2: .* bytes of 0"),
        ("a.log", "(1.0) can0 181#01\n(1.1) can0 181#01\n".encode("utf-16-le"), "line 1: .* UTF-16 without a mark"),
        ("a.trc", b";$FILEVERSION=1.2\n 1) 1.0 1 Rx 0181 1 01\n", "line 2: .* of TRC, got 1.2"),
        ("a.csv", b"1.0,0x181,0,0,0,1,AQ==\n", "line 1: .* expected the names of the columns"),
        ("a.csv", b"timestamp\n1.0,0x181,0,0,0,2,AQ==\n", "line 2: .* a frame of 2 bytes, of which the log holds 1"),
        ("a.asc", ASC.replace(b"06 07 08\n", b"06\n") % b"absolute", "line 7: .* of which the log holds 6"),
        ("a.blf", blf_file([blf_frame(0), blf_object(1, bytes(4))]), "frame 1: cannot be read"),
        ("a.blf", blf_file([blf_frame(0), b"LOBX" + blf_frame(1)[4:]]), "frame 1: .* no object where one is due"),
    ],
)
def test_what_cannot_be_is_refused_with_its_place(tmp_path: Path, name: str, content: bytes, says: str) -> None:
    with pytest.raises(InputError, match=says):
        read(tmp_path / name, content)


def test_a_blf_without_its_end_is_read_up_to_there(tmp_path: Path) -> None:
    path = tmp_path / "a.blf"
    objects = [blf_frame(number) for number in range(40)]
    whole, said = read(path, blf_file(objects))
    assert (len(whole["0"]), said) == (40, [])
    found, said = read(path, blf_file(objects)[: 176 + 10 * 48 + 5])
    assert (len(found["0"]), said) == (10, [": ends at byte 144 with 10 of its 40 objects: the rest is missing"])
    found, said = read(path, blf_file(objects, 0))
    assert (len(found["0"]), said) == (40, [": was not closed: what came after its 40 objects is missing"])


def write(path: Path) -> None:
    """Write 300 frames."""
    if path.suffix == ".mcap":
        came = frames(300)
        came["can_id"], came["length"], came["time_ns"] = 0x181, 8, 10_000_000 * np.arange(300)
        sink = open_sink(path, small_contract(), 0, 10**18)
        sink.frames(0, came, 10**18, 10**18)
        sink.close()
        return
    with can.Logger(path) as logger:
        for number in range(300):
            data = zlib.crc32(bytes([number % 256])).to_bytes(4, "little")
            logger(can.Message(timestamp=1e9 + number * 0.01, arbitration_id=0x181, data=data, is_extended_id=False))


SUFFIXES = (".mcap", ".log", ".asc", ".blf", ".trc", ".csv", ".db", ".log.gz")


@pytest.mark.heavy
@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_log_damaged_anywhere_is_whole_or_says_what_is_missing(tmp_path: Path, suffix: str) -> None:
    """Cut off, or with 32 bytes of 0, at a hundred places each."""
    path = tmp_path / f"a{suffix}"
    write(path)
    content = path.read_bytes()
    random = np.random.default_rng(1)
    for place in random.integers(1, len(content), 100).tolist():
        for damaged in (content[:place], content[:place] + bytes(32) + content[place + 32 :]):
            found, said = {}, []
            try:
                found, said = read(path, damaged)
            except InputError as error:
                said = [str(error)]
            count = sum(map(len, found.values()))
            line_by_line = damaged == content[:place] and damaged.endswith((b"\r", b"\n"))
            is_whole = count == 300 or said or line_by_line
            assert is_whole, (suffix, place, count)
            assert all("\n" not in line for line in said)


def candump(times_s: list[float], channels: str = "0") -> bytes:
    lines = [f"({time_s:.6f}) can{channels[place % len(channels)]} 181#01" for place, time_s in enumerate(times_s)]
    return ("\n".join(lines) + "\n").encode()


STEADY = [0.01 * place for place in range(100)]


@pytest.mark.parametrize(
    ("content", "kept", "says"),
    [
        (candump(STEADY), 100, []),
        (
            candump([*STEADY[:60], *[each - 0.5 for each in STEADY[60:]]]),
            60,
            ["line 61: the time of channel can0 falls by 0.49 s: 60 of 100 frames, where it does not, are read from "],
        ),
        (candump([5 + each for each in STEADY[:30]] + STEADY[:70]), 70, ["line 31: the time of channel can0 falls by"]),
        (candump([*STEADY[:50], 1e9, *STEADY[50:]]), 51,
         ["line 52: the time of channel can0 falls", "line 51: the"]),
        (candump([*STEADY, *[3600 + each for each in STEADY]]), 200, ["line 101: the time jumps by 3599.01 s"]),
        (candump([each + 3 * (i % 2) for i, each in enumerate(STEADY)], "01"), 100,
         ["line 3: channel can0 is 2.99 s behind the others: have the channels two clocks?"]),
        (candump([each - 0.02 * (i % 10 == 0) + 1 for i, each in enumerate(STEADY)]), 100, []),
        (candump([0.0001 + 0.009 * (i % 3 == 0) for i in range(99)]), 99, ["line 2: 33 of 99 times fall: are they"]),
    ],
)  # fmt: skip
def test_time_goes_forward_or_it_is_said_where_not(tmp_path: Path, content: bytes, kept: int, says: list[str]) -> None:
    found, said = read(tmp_path / "a.log", content)
    assert sum(map(len, found.values())) == kept
    assert len(said) == len(says)
    assert all(line.startswith(f", {expected}") for line, expected in zip(said, says, strict=True)), said
    for seen in found.values():
        assert (np.diff(seen["time_ns"]) >= 0).all()


def test_times_that_are_relative_to_the_event_before_are_added(tmp_path: Path) -> None:
    found, _ = read(tmp_path / "a.asc", CORPUS["relative.asc"])
    assert found["0"]["time_ns"] / 1e9 == pytest.approx([0.1, 0.4, 0.5, 0.7])
    assert found["1"]["time_ns"] / 1e9 == pytest.approx([0.8])
