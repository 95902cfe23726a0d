"""Files that claim or unpack to far more than they hold: one error, little memory, little time."""

import gzip
import os
import subprocess
import sys
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Final

import lz4.frame
import numpy as np
import pytest
import tomli_w
import zstandard
from can.io import blf
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.data_stream import RecordBuilder
from mcap.records import Chunk
from mcap.writer import Writer

from canskin.errors import LayoutError
from recording.mcap_file import PROFILE
from skin.limits import decode_toml

#: Most of a process that reads a file, its start and libraries included.
MEMORY_MB: Final = 200
PROCESSOR_S: Final = 2.0
UNPACKED: Final = 2**28
#: Reads `path` with `{call}`, and ends as the command line does.
READER: Final = """
import sys
import time
from pathlib import Path
from canskin.errors import SkinError
from {room} import {name}
try:
    {name}(Path(sys.argv[1]), {rest})
except SkinError as error:
    print(error)
memory = next(line for line in open("/proc/self/status") if line.startswith("VmHWM"))
print(memory.split()[1], time.process_time())
"""


def text(*parts: tuple[str, int], sparse: int = 0) -> Callable[[Path], None]:
    def write(path: Path) -> None:
        path.write_text("".join(each * times for each, times in parts))
        if sparse:
            os.truncate(path, sparse)

    return write


def packed(size: int, *, claimed: bool = False, entries: int = 1, end: bytes = b"") -> Callable[[Path], None]:
    """An .npz of zeros."""

    def write(path: Path) -> None:
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as file:
            for number in range(entries):
                with file.open(f"phi{number or ''}.npy", "w", force_zip64=True) as entry:
                    shape = (1, 1, 2**42 if claimed else size)
                    about = {"descr": "|u1", "fortran_order": False, "shape": shape}
                    np.lib.format.write_array_header_1_0(entry, about)
                    for _ in range(0, size, 2**24):
                        entry.write(bytes(min(size, 2**24)))
        with path.open("ab") as file:
            file.write(end)

    return write


def claiming(path: Path) -> None:
    about = {"descr": "|u1", "fortran_order": False, "shape": (1, 1, 2**42)}
    with path.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, about)


def chunk(compression: str, data: Callable[[], bytes], size: int) -> Callable[[Path], None]:
    """A recording with one chunk."""

    def write(path: Path) -> None:
        with path.open("wb") as file:
            writer = Writer(file)
            writer.start(PROFILE)
            record = RecordBuilder()
            Chunk(compression, data(), 2, 1, 0, size).write(record)
            file.write(record.end())
            writer.finish()

    return write


def zeros_zstd() -> bytes:
    return zstandard.ZstdCompressor(level=1).compress(bytes(UNPACKED))


def zeros_lz4() -> bytes:
    packer = lz4.frame.LZ4FrameCompressor(block_size=lz4.frame.BLOCKSIZE_MAX4MB)
    parts = [packer.begin(), *(packer.compress(bytes(2**22)) for _ in range(128)), packer.flush()]
    return b"".join(parts)


def record(length: int, size: int) -> Callable[[Path], None]:
    """A recording with a record of some length, that is not in the file."""

    def write(path: Path) -> None:
        chunk("", lambda: b"", 0)(path)
        content = path.read_bytes()
        place = content.index(b"\x06", 8 + 9)
        path.write_bytes(content[: place + 1] + length.to_bytes(8, "little"))
        os.truncate(path, size)

    return write


def container(content: Callable[[], bytes], times: int = 1) -> Callable[[Path], None]:
    """A log (.blf) with packed containers."""

    def write(path: Path) -> None:
        packed = zlib.compress(content(), 1)
        body = blf.LOG_CONTAINER_STRUCT.pack(blf.ZLIB_DEFLATE, 0) + packed
        head = blf.OBJ_HEADER_BASE_STRUCT.pack(b"LOBJ", 16, 1, 16 + len(body), blf.LOG_CONTAINER)
        path.write_bytes(
            b"LOGG" + (144).to_bytes(4, "little") + bytes(136) + (head + body + bytes(len(body) % 4)) * times
        )

    return write


def message(length: int) -> bytes:
    """A frame as BLF has it, in an object of some length."""
    head = blf.OBJ_HEADER_BASE_STRUCT.pack(b"LOBJ", 32, 1, length, blf.CAN_MESSAGE)
    return head + blf.OBJ_HEADER_V1_STRUCT.pack(2, 0, 0, 0) + blf.CAN_MSG_STRUCT.pack(1, 0, 8, 0x181, bytes(8))


def zipped(content: bytes, times: int) -> Callable[[Path], None]:
    def write(path: Path) -> None:
        with gzip.open(path, "wb", compresslevel=9) as file:
            for _ in range(times):
                file.write(content)

    return write


LOG: Final = ("bandwidth.logs", "read_log", "print")
LAYOUT: Final = ("skin.layout", "load_layout", "")
RECORDING: Final = ("touch.reading", "read_counts", "None")
MATRIX: Final = ("skin.matrix", "read_matrix", "")
RUN: Final = ("recording.mcap_file", "read_topics", "")
ATTACKS: Final = {
    "a key of 20,000 parts": ("a.toml", text(("a.", 20_000), ("a = 1", 1)), LAYOUT, "keys of at most 8 parts"),
    "a table of 20,000 parts": ("a.toml", text(("[", 1), ("a . ", 20_000), ("a]", 1)), LAYOUT, "at most 8 parts"),
    "a key of quoted parts": ("a.toml", text(('"\\""."a,b".', 9_000), ("a = 1", 1)), LAYOUT, "dots beside quotes"),
    "a layout of 300 MB": ("a.toml", text(("#", 1), sparse=300_000_000), LAYOUT, "got 300000000"),
    "many keys": ("a.toml", text(("a = 1\n", 700_000)), LAYOUT, "keys and tables"),
    "many tables": ("a.toml", text((" [['a,1']] # ,\n", 100_000)), LAYOUT, "keys and tables"),
    "millions of values": ("a.toml", text(("a = [", 1), ("1,", 4_000_000)), LAYOUT, "commas"),
    "lists in lists": ("a.toml", text(("a = ", 1), ("[", 100_000)), LAYOUT, "expected TOML"),
    "a number of a million digits": ("a.toml", text(("a = ", 1), ("1", 1_000_000)), LAYOUT, "expected TOML"),
    "a device": ("/dev/zero", None, LAYOUT, "got 16777217"),
    "an npz that unpacks to 268 MB": ("a.npz", packed(UNPACKED), RECORDING, "got 268435"),
    "an npz of Φ": ("phi.npz", packed(UNPACKED), MATRIX, "bytes unpacked, got 268435"),
    "many arrays": ("a.npz", packed(2**24, entries=8), RECORDING, "bytes unpacked, got 134"),
    "a header of 4 TB in an npz": ("a.npz", packed(10, claimed=True), RECORDING, "cannot be read"),
    "a header of 4 TB": ("a.npy", claiming, RECORDING, "cannot be read"),
    "a directory of 3 MB": ("a.npz", packed(0, entries=30_000), RECORDING, "directory of at most 65536"),
    "an end with a comment": ("a.npz", packed(10, end=b"comment"), RECORDING, "directory of at most 65536"),
    "a chunk that claims its size": ("a.mcap", chunk("zstd", zeros_zstd, UNPACKED), RUN, "got 268435456"),
    "a chunk that claims less": ("a.mcap", chunk("zstd", zeros_zstd, 100), RUN, "unpacked, got 8388609"),
    "a chunk of lz4": ("a.mcap", chunk("lz4", zeros_lz4, 100), RUN, "unpacked, got 8388609"),
    "a record of 2 GB": ("a.mcap", record(2**31, 2**33), RUN, ""),
    "chains of 300 MB": ("a.csv", text(("1", 1), sparse=300_000_000), ("skin.chains", "read_positions", ""), "got 3"),
    "a million columns": ("a.csv", text(("a,", 10**6), ("\n1", 10**6)), ("skin.chains", "read_positions", ""), "16 c"),
    "a container of 268 MB": ("a.blf", container(lambda: bytes(UNPACKED)), LOG, "at most 4194304 bytes unpacked"),
    "a container that goes on": ("a.blf", container(lambda: message(2**32 - 1) * 2**16, 4), LOG, "bytes unpacked"),
    "frames without end": ("a.blf", container(lambda: message(48) * 2**16, 2), LOG, "frames in a file of this size"),
    "an object of no length": ("a.blf", container(lambda: message(0)), LOG, "an object of no length"),
    "a line of 268 MB": ("a.log.gz", zipped(bytes(2**20), 256), LOG, "line 1: cannot be read"),
    "two million lines": ("a.log.gz", zipped(b"(1.0) can0 181#01\n" * 2**16, 32), LOG, "frames in a file of this size"),
    "a log of 300 MB without lines": ("a.txt", text(("1", 1), sparse=300_000_000), LOG, "cannot be read"),
    "a calibration": (
        "a.json",
        text(("[1,", 1), sparse=300_000_000),
        ("skin.calibration_file", "load_calibration", "None"),
        "got 3",
    ),
}


@pytest.mark.heavy
@pytest.mark.parametrize("attack", ATTACKS)
def test_reader_refuses_at_little_cost(attack: str, tmp_path: Path) -> None:
    name, write, (room, reader, rest), expected = ATTACKS[attack]
    path = tmp_path / name
    if write is not None:
        write(path)
    code = READER.format(room=room, name=reader, rest=rest)
    *said, used = subprocess.check_output([sys.executable, "-c", code, str(path)], text=True).splitlines()
    memory_kb, processor_s = map(float, used.split())
    assert expected in "".join(said)
    assert memory_kb < MEMORY_MB * 1e3
    assert processor_s < PROCESSOR_S


@settings(max_examples=200)
@given(st.integers(1, 12), st.sampled_from(["a", '"a"', "'b.c'", "a-1"]), st.sampled_from([".", " . ", ".\t"]))
def test_keys_have_up_to_eight_parts(parts: int, part: str, dot: str) -> None:
    """Numbers with points, and points in comments and texts, are no parts of keys."""
    key = dot.join([part] * parts)
    content = f"{key} = [0.25, 1.5, 2.5] # a. b. c.\nz = 'a. b.'".encode()
    if parts > 8 and part[0] == "a":
        with pytest.raises(LayoutError, match="keys of at most 8 parts"):
            decode_toml(content, "a.toml")
    else:
        assert decode_toml(content, "a.toml")["z"] == "a. b."


def test_the_largest_layout_is_within_the_limits() -> None:
    """65,536 taxels at places of many digits, with normals and chains, as `layout_text` writes them."""
    places = [[0.1234567890123456 + taxel * 1e-7] * 6 for taxel in range(2**16)]
    chains = np.arange(2**16).reshape(-1, 128).tolist()
    tables = {"taxels": {"positions": places}, "measurement": {"chains": chains, "wiring": "file"}}
    assert decode_toml(tomli_w.dumps(tables).encode(), "a.toml") == tables


@pytest.mark.heavy
def test_a_wrong_file_ends_the_command_with_2(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text("a." * 20_000 + "a = 1")
    command = [sys.executable, "-m", "skin", "plan", "--layout", str(tmp_path / "a.toml")]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stderr.count("\n")) == (2, 1)
