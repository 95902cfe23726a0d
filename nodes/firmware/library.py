"""The firmware of many boards as a library for this machine, compiled with the system's C compiler and kept."""

import ctypes
import hashlib
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from canskin.errors import InputError, reasoned
from dbc.canopen import BASE_ID_MASK
from dbc.contract import Contract, NodeContract
from dbc.frame import Frames, frames
from dbc.generate import write_files
from nodes.firmware.export import constants, sources
from nodes.firmware.flash import Flash, FlashDriver, flash_of_node
from nodes.firmware.storage import StorageFunction, storage_function
from nodes.firmware.tables import builds
from nodes.storage import Storage
from shell.output import cache_folder

#: Every operation is rounded as it is written.
STANDARD_FLAGS: Final = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-ffp-contract=off")
_FLAGS: Final = (*STANDARD_FLAGS, "-O3", "-fno-math-errno", "-fno-trapping-math", "-fPIC", "-shared")
#: Frames that the boards of one bus may answer at once; more are lost.
_CAPACITY: Final = 4096
_U32, _I64, _SIZE, _POINTER = ctypes.c_uint32, ctypes.c_int64, ctypes.c_size_t, ctypes.c_void_p
#: What the functions of ``skin_boards.h`` take; those that return something return a ``size_t``.
_FUNCTIONS: Final[dict[str, tuple[type, ...]]] = {
    "skin_power_up": (_POINTER, _U32, _U32, _POINTER, _POINTER, ctypes.c_int, _U32, _POINTER, _SIZE),
    "skin_take": (_POINTER, _U32, _U32, _POINTER, ctypes.c_uint16, _U32, _POINTER, _SIZE, _POINTER, _SIZE),
    "skin_pass_time": (_POINTER, _U32, _U32, _POINTER, _SIZE),
    "skin_refuse": (_POINTER, _U32, _POINTER, _SIZE),
    "skin_node_bytes": (),
}
_STEPPED_FUNCTIONS: Final[dict[str, tuple[type, ...]]] = {
    "skin_prepare": (_POINTER, _U32, _U32, _POINTER),
    "skin_take_counts": (_POINTER, _U32, _POINTER),
    "skin_choose": (_POINTER, _U32, _I64, _POINTER, _SIZE),
    "skin_under_way": (_POINTER, _U32),
}


class Firmware:
    """The compiled firmware of some boards; raise InputError if it cannot be compiled and kept.

    Parameters
    ----------
    nodes : sequence of NodeContract
        The boards, those of each bus one after another.
    store : Path, optional
        Folder for the parameters that 1010h stores, one file per node, and for loaded programs; without a folder they
        end with the process.
    unnumbered : bool
        Whether the boards wait for LSS to give them their node-IDs, unless `store` has them.
    compiler : str
        The C compiler.
    """

    def __init__(
        self,
        contract: Contract,
        nodes: Sequence[NodeContract],
        *,
        store: Path | None = None,
        unnumbered: bool = False,
        compiler: str = "cc",
    ) -> None:
        buses = {node.bus for node in nodes}
        # LSS gives a board any node-ID of its bus.
        others = [node for node in contract.nodes if unnumbered and node.bus in buses and node not in nodes]
        boards = builds(contract, [*nodes, *others])
        # With the CANopen slave, and what runs many of them together.
        texts = sources(boards, "slave", "host") | constants(contract, boards)
        self._library = _loaded(texts, compiler)
        for name, types in (_FUNCTIONS | (_STEPPED_FUNCTIONS if boards[0].in_steps else {})).items():
            function = getattr(self._library, name)
            function.argtypes, function.restype = types, ctypes.c_size_t
        self._contract, self._nodes = contract, nodes
        self._unnumbered = unnumbered
        self._memories = [
            (
                storage_function(each, Storage.of_node(contract, node, store)),
                flash_of_node(contract, node, store),
            )
            for each, node in zip(boards, nodes, strict=False)
        ]
        self._boards: dict[int, CompiledBoards] = {}

    def boards(self, bus: int) -> "CompiledBoards":
        """Return the boards of bus number `bus`, which have no power before the first call of `power_up`."""
        if bus not in self._boards:
            nodes = [node for node in self._nodes if node.bus == bus]
            first = self._nodes.index(nodes[0])
            memories = self._memories[first : first + len(nodes)]
            self._boards[bus] = CompiledBoards(
                self._library, self._contract, nodes, first, memories, unnumbered=self._unnumbered
            )
        return self._boards[bus]


class CompiledBoards:
    """The boards of one bus: most methods take a time in seconds and return the frames that the boards send.

    Stepped boards sample by their own clock (`take_counts`), and send steps in their slots (`choose`).

    Parameters
    ----------
    nodes : sequence of NodeContract
        The boards, in the order of the library.
    first : int
        The first of them among all boards of the library.
    memories : sequence of (StorageFunction, Flash)
        Of each board: for parameters, and for programs.
    unnumbered : bool
        As for `Firmware`.

    Attributes
    ----------
    node_ids : frozenset of int
    is_pdo : array of bool, shape (BASE_ID_MASK + 1,)
        Whether an identifier is that of a TPDO of the boards.
    due_s : float
        When `pass_time` has work to do: at any time.
    """

    def __init__(
        self,
        library: ctypes.CDLL,
        contract: Contract,
        nodes: Sequence[NodeContract],
        first: int,
        memories: Sequence[tuple[StorageFunction, Flash]],
        *,
        unnumbered: bool,
    ) -> None:
        self.node_ids = frozenset(node.node_id for node in nodes)
        self.is_pdo = np.zeros(BASE_ID_MASK + 1, np.bool_)
        for node in nodes:
            self.is_pdo[[tpdo.cob_id for tpdo in node.tpdos]] = True
        self.due_s = float("-inf")
        self._library = library
        self._first, self._count = first, len(nodes)
        self._unnumbered = unnumbered
        self._memories = memories  # the drivers have the addresses of its functions alone
        self._storages = (StorageFunction * len(nodes))(*(storage for storage, _ in memories))
        self._drivers = (FlashDriver * len(nodes))(*(flash.driver for _, flash in memories))
        # Eight bytes each, so that the memory is aligned for every C type.
        self._memory = np.zeros(-(-len(nodes) * library.skin_node_bytes() // 8), np.uint64)
        self._nodes = self._memory.ctypes.data
        phi, ranges = contract.phi, [(each.block, each.block + each.blocks) for each in nodes]
        self._block_size = phi.block_size
        if contract.layout.taxels.is_analogue:
            self._converters, order = phi.shape[0], [np.arange(*phi.starts[[first, end]]) for first, end in ranges]
        else:
            self._converters, order = phi.wired.taxels, [phi.taxels_of_blocks[slice(*each)].ravel() for each in ranges]
        self._order = np.concatenate(order)
        self._most_samples = 2 * contract.layout.samples_per_sync
        self._out = frames(_CAPACITY)
        self._sent = self._out.ctypes.data, _CAPACITY
        if contract.layout.sending == "steps":
            self._library.skin_prepare(self._nodes, self._first, self._count, self._storages)

    def power_up(self, now_s: float) -> Frames:
        """Begin anew, with the stored parameters or the default ones."""
        return self._taken(
            self._library.skin_power_up(
                self._nodes,
                self._first,
                self._count,
                self._storages,
                self._drivers,
                self._unnumbered,
                _milliseconds(now_s),
                *self._sent,
            )
        )

    def take(self, arrived: Frames, now_s: float) -> Frames:
        """Pass received frames to the boards."""
        return self.answer(arrived, now_s, None)

    def answer(self, sync: Frames, now_s: float, measured: npt.NDArray[np.int32] | None) -> Frames:
        """Pass a SYNC to the boards.

        Parameters
        ----------
        measured : array of int, shape (samples, n) or (samples, m), optional
            What all converters of the skin read since the last SYNC: counts of the taxels, row-major, or codes of the
            sums; the last sample is that of the SYNC. At most the samples of two cycles.
        """
        there = np.ascontiguousarray(sync)
        read, samples = None, 0
        if measured is not None:
            samples, converters = measured.shape
            if converters != self._converters or not 0 < samples <= self._most_samples:
                wanted = f"1 to {self._most_samples} samples of {self._converters} converters"
                raise InputError(f"expected {wanted}, got {measured.shape}")
            readings = measured[:, self._order].astype(np.uint16, order="C")  # codes in two's complement
            read = readings.ctypes.data
        return self._taken(
            self._library.skin_take(
                self._nodes,
                self._count,
                _milliseconds(now_s),
                read,
                samples,
                len(self._order),
                there.ctypes.data,
                len(there),
                *self._sent,
            )
        )

    def pass_time(self, now_s: float) -> Frames:
        """Do what is due by time."""
        return self._taken(self._library.skin_pass_time(self._nodes, self._count, _milliseconds(now_s), *self._sent))

    def refuse(self, burst: Frames) -> None:
        """Take note of TPDOs that found no room in the transmit queue."""
        there = np.ascontiguousarray(burst)
        self._library.skin_refuse(self._nodes, self._count, there.ctypes.data, len(there))

    def take_counts(self, counts: npt.NDArray[np.float32]) -> bool:
        """Pass one sample to the boards, shape (boards, taxels); tell whether all have learned their noise."""
        expected = (self._count, self._block_size)
        if counts.shape != expected:
            raise InputError(f"expected counts of {expected}, got {counts.shape}")
        there = counts.astype(np.uint16, order="C")  # a copy: corrected in place
        ready = self._library.skin_take_counts(self._nodes, self._count, there.ctypes.data)
        return bool(ready == self._count)

    def choose(self, now_ns: int) -> Frames:
        """Make the frames of the slots that have begun, of the newest sample."""
        return self._taken(self._library.skin_choose(self._nodes, self._count, now_ns, *self._sent))

    @property
    def is_sending(self) -> bool:
        """Whether a controller may hold a frame, or its echo is to be read."""
        return bool(self._library.skin_under_way(self._nodes, self._count))

    def _taken(self, count: int) -> Frames:
        taken: Frames = self._out[:count].copy()
        return taken


def _milliseconds(now_s: float) -> int:
    """Return a time as the boards count it: milliseconds that wrap."""
    return round(now_s * 1000) & 0xFFFF_FFFF


def _loaded(texts: dict[str, str], compiler: str) -> ctypes.CDLL:
    """Return the library made of `texts`; a file in the cache that cannot be loaded is made anew."""
    path = _compiled(texts, compiler)
    try:
        return ctypes.CDLL(str(path))
    except OSError:
        path.unlink(missing_ok=True)
    try:
        return ctypes.CDLL(str(_compiled(texts, compiler)))
    except OSError as error:
        raise InputError(f"{path}: cannot load the compiled firmware: {error}") from error


def _compiled(texts: dict[str, str], compiler: str) -> Path:
    """Return the path of the library made of `texts`; it is compiled unless the cache has it."""
    program = shutil.which(compiler)
    if program is None:
        raise InputError(f"expected a C compiler as '{compiler}': install one, for example gcc or clang")
    digest = hashlib.sha256(repr((program, _FLAGS, sorted(texts.items()))).encode()).hexdigest()[:16]
    path = cache_folder() / f"firmware-{digest}.so"
    if path.exists():
        return path
    with reasoned(InputError, f"{path}: cannot keep the compiled firmware"):
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent) as name:
            folder = Path(name)
            made = folder / "firmware.so"
            compile_c(write_files(texts, folder), made, [program, *_FLAGS])
            made.replace(path)  # in one step: another process may look for the file
    return path


def compile_c(paths: Sequence[Path], out: Path, command: Sequence[str]) -> None:
    """Compile the sources among `paths` to `out` with the compiler and the flags of `command`.

    If the compiler fails, raise InputError with its first error.
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
