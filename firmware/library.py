"""The firmware of many boards as a library for this machine, compiled with the system's C compiler and kept."""

import ctypes
import hashlib
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from dbc.contract import Contract, NodeContract
from dbc.frame import Frames, frames
from dbc.generate import write_files
from firmware.tables import board_header, board_source, builds
from skin.cache import cache_folder
from skin.errors import InputError

#: Sources of the library by folder: sums and packing, a CANopen slave, and what runs many of them together.
SOURCES: Final = files("firmware").joinpath("c")
FOLDERS: Final = ("", "slave", "host")
STANDARD_FLAGS: Final = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic")
_FLAGS: Final = (*STANDARD_FLAGS, "-O3", "-fno-math-errno", "-fno-trapping-math", "-fPIC", "-shared")
#: Frames that the boards of one bus may answer at once; more are lost.
_CAPACITY: Final = 4096


def sources(*folders: str) -> dict[str, str]:
    """Return the C sources and headers of folders of the package by their path; a folder's name may be empty."""
    found: dict[str, str] = {}
    for folder in folders:
        for each in sorted(SOURCES.joinpath(folder).iterdir(), key=lambda each: each.name):
            if each.name.endswith((".c", ".h")):
                found[f"{folder}/{each.name}" if folder else each.name] = each.read_text(encoding="ascii")
    return found


class Firmware:
    """The compiled firmware of some boards.

    Parameters
    ----------
    contract : Contract
    nodes : sequence of NodeContract
        The boards, those of each bus one after another.
    compiler : str
        The C compiler.

    Raises
    ------
    InputError
        If there is no compiler, it fails, the cache folder cannot be written, or the nodes send adaptively.
    """

    def __init__(self, contract: Contract, nodes: Sequence[NodeContract], *, compiler: str = "cc") -> None:
        boards = builds(contract, nodes)
        texts = sources(*FOLDERS) | {"board.h": board_header(contract, boards), "board.c": board_source(boards)}
        self._library = ctypes.CDLL(str(_compiled(texts, compiler)))
        self._place = {(node.bus, node.node_id): place for place, node in enumerate(nodes)}
        for name in ("skin_power_up", "skin_take", "skin_pass_time", "skin_newest_sums", "skin_node_bytes"):
            getattr(self._library, name).restype = ctypes.c_size_t
        self._node_bytes = int(self._library.skin_node_bytes())
        self._taxels = contract.phi.order.size
        self._most_samples = 2 * contract.layout.samples_per_sync

    def node_ids(self, bus: int) -> frozenset[int]:
        """Return the node-IDs of the boards of bus number `bus`."""
        return frozenset(node_id for on, node_id in self._place if on == bus)

    def boards(self, bus: int) -> "Boards":
        """Return the boards of bus number `bus`, without power."""
        places = sorted(place for (on, _), place in self._place.items() if on == bus)
        return Boards(
            self._library,
            places[0],
            len(places),
            node_bytes=self._node_bytes,
            taxels=self._taxels,
            most_samples=self._most_samples,
        )


class Boards:
    """The boards of one bus: every method takes a time in seconds and returns the frames that the boards send."""

    def __init__(
        self, library: ctypes.CDLL, first: int, count: int, *, node_bytes: int, taxels: int, most_samples: int
    ) -> None:
        self._library = library
        self._first, self._count = ctypes.c_uint32(first), ctypes.c_uint32(count)
        # Eight bytes each, so that the memory is aligned for every C type.
        self._memory = np.zeros(-(-count * node_bytes // 8), np.uint64)
        self._nodes = ctypes.c_void_p(self._memory.ctypes.data)
        self._node_bytes = node_bytes
        self._taxels, self._most_samples = taxels, most_samples
        self._out = frames(_CAPACITY)
        self._sent = (ctypes.c_void_p(self._out.ctypes.data), ctypes.c_size_t(_CAPACITY))

    def power_up(self, now_s: float) -> Frames:
        """Begin anew, with the default parameters."""
        return self._taken(
            self._library.skin_power_up(self._nodes, self._first, self._count, _milliseconds(now_s), *self._sent)
        )

    def take(self, arrived: Frames, now_s: float, counts: npt.NDArray[np.uint16] | None = None) -> Frames:
        """Pass received frames to the boards.

        Parameters
        ----------
        arrived : Frames
            With one SYNC at most.
        counts : array of uint16, shape (samples, n), optional
            What all taxels of the skin read since the last SYNC, row-major, ADC counts; the last sample is that of the
            SYNC. At most the samples of two cycles.
        """
        there = np.ascontiguousarray(arrived)
        read, samples = None, 0
        if counts is not None:
            samples, taxels = counts.shape
            is_right = taxels == self._taxels and 0 < samples <= self._most_samples and counts.flags.c_contiguous
            if not is_right or counts.dtype != np.uint16:
                wanted = f"1 to {self._most_samples} samples of {self._taxels} counts, uint16"
                raise InputError(f"expected {wanted}, got {counts.dtype} of {counts.shape}")
            read = ctypes.c_void_p(counts.ctypes.data)
        return self._taken(
            self._library.skin_take(
                self._nodes,
                self._count,
                _milliseconds(now_s),
                read,
                ctypes.c_uint16(samples),
                ctypes.c_uint32(self._taxels),
                ctypes.c_void_p(there.ctypes.data),
                ctypes.c_size_t(len(there)),
                *self._sent,
            )
        )

    def pass_time(self, now_s: float) -> Frames:
        """Do what is due by time."""
        return self._taken(self._library.skin_pass_time(self._nodes, self._count, _milliseconds(now_s), *self._sent))

    def sums(self, board: int, count: int) -> npt.NDArray[np.int32]:
        """Return the newest `count` sums of board number `board` of this bus, ADC counts."""
        sums = np.zeros(count, np.int32)
        node = ctypes.c_void_p(self._memory.ctypes.data + board * self._node_bytes)
        self._library.skin_newest_sums(node, ctypes.c_void_p(sums.ctypes.data))
        return sums

    def _taken(self, count: int) -> Frames:
        taken: Frames = self._out[:count].copy()
        return taken


def _milliseconds(now_s: float) -> ctypes.c_uint32:
    """Return a time as the boards count it: milliseconds that wrap."""
    return ctypes.c_uint32(round(now_s * 1000) & 0xFFFF_FFFF)


def _compiled(texts: dict[str, str], compiler: str) -> Path:
    """Return the path of the library made of `texts`; it is compiled unless the cache has it."""
    program = shutil.which(compiler)
    if program is None:
        raise InputError(f"expected a C compiler as '{compiler}': install one, for example gcc or clang")
    digest = hashlib.sha256(repr((program, _FLAGS, sorted(texts.items()))).encode()).hexdigest()[:16]
    path = cache_folder() / f"firmware-{digest}.so"
    if path.exists():
        return path
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent) as name:
            folder = Path(name)
            made = folder / "firmware.so"
            compile_c(write_files(texts, folder), made, [program, *_FLAGS])
            made.replace(path)  # in one step: another process may look for the file
    except OSError as error:
        raise InputError(f"{path}: cannot keep the compiled firmware: {error.strerror or error}") from error
    return path


def compile_c(paths: Sequence[Path], out: Path, command: Sequence[str]) -> None:
    """Compile the sources among `paths` to `out` with the compiler and the flags of `command`.

    Raises
    ------
    InputError
        If the compiler fails; the message has its first error.
    """
    folders = sorted({f"-I{path.parent}" for path in paths})
    texts = [str(path) for path in paths if path.suffix == ".c"]
    done = subprocess.run(  # noqa: S603 - the compiler of this machine, without a shell
        [*command, *folders, "-o", str(out), *texts, "-lm"], capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        lines = done.stderr.splitlines() or [f"exit code {done.returncode}"]
        first = next((line for line in lines if "error" in line), lines[0])
        raise InputError(f"{command[0]} cannot compile the firmware: {first}")
