"""Adaptive boards that run the C firmware (`firmware`) in place of `nodes.adaptive.node`."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from bus.link import Send
from dbc.adaptive_filter import Floats
from dbc.contract import Contract
from dbc.frame import ECHO, ERROR, Frames
from firmware.library import CompiledAdaptiveBoards, Firmware
from nodes.adaptive.patch_boards import PatchBoards
from nodes.adaptive.timing import SendingTimes
from nodes.firmware_segment import BoardsSegment
from nodes.segment import TICK_S
from skin.sources import TaxelSource


class FirmwarePatches(PatchBoards):
    """All boards of a process: they get the samples of their patches. Gains, offsets and patterns are theirs alone.

    Parameters
    ----------
    firmware : Firmware
        Compiled for these boards.

    The others are those of `PatchBoards`.
    """

    def __init__(
        self, contract: Contract, blocks: Sequence[int], source: TaxelSource, firmware: Firmware, **analogue: Any
    ) -> None:
        super().__init__(contract, blocks, source, **analogue)
        self._firmware = firmware
        nodes = [contract.nodes[block] for block in blocks]
        self._boards: dict[int, tuple[slice, CompiledAdaptiveBoards]] = {}
        for bus in sorted({node.bus for node in nodes}):
            rows = [row for row, node in enumerate(nodes) if node.bus == bus]
            self._boards[bus] = slice(rows[0], rows[-1] + 1), firmware.adaptive_boards(bus)
        self._nodes = {node.block: (node.bus, row - self._boards[node.bus][0].start) for row, node in enumerate(nodes)}
        # The boards learn the noise of the untouched skin, as when they are switched on.
        while not self._pass_counts():
            pass

    def on_bus(self, bus: int) -> CompiledAdaptiveBoards:
        """Return the boards of a bus."""
        return self._boards[bus][1]

    def node_ids(self, bus: int) -> frozenset[int]:
        """Return the node-IDs of the boards of a bus."""
        return self._firmware.node_ids(bus)

    def _pass_counts(self) -> bool:
        self._sensors.sample(0)
        return self._take_counts()

    def _take_counts(self) -> bool:
        counts = self._sensors.counts.astype(np.uint16)
        ready = [boards.take_counts(counts[rows]) for rows, boards in self._boards.values()]
        return all(ready)

    def _take(self, sample_n: Floats) -> None:  # noqa: ARG002  boards sample in counts
        self._take_counts()

    def _decide(self, now_ns: int, passed_ns: int, skipped: int) -> bool:  # noqa: ARG002  boards count samples
        due = [boards.decide(skipped, passed_ns) for _, boards in self._boards.values()]
        return any(due)

    @property
    def is_sending(self) -> bool:
        """Whether a controller may hold a frame, or its echo is to be read."""
        return any(boards.is_sending for _, boards in self._boards.values())

    @property
    def sums(self) -> npt.NDArray[np.int32]:
        """The sums of the filtered forces in counts, in the order of Φ, shape (m,); those of other boards are 0."""
        size = self._phi.block_size
        sums = np.zeros(self._phi.shape[0], np.int32)
        for block, (bus, board) in self._nodes.items():
            sums[block * size : (block + 1) * size] = self._boards[bus][1].sums(board, size)
        return sums


class AdaptiveFirmwareSegment(BoardsSegment):
    """The adaptive boards of one bus.

    Parameters
    ----------
    patches : FirmwarePatches
        All boards of the process.

    The others are those of `BoardsSegment`.
    """

    def __init__(
        self,
        contract: Contract,
        bus: int,
        send: Send,
        patches: FirmwarePatches,
        *,
        complain: Callable[[str], None],
    ) -> None:
        boards = patches.on_bus(bus)
        super().__init__(contract, bus, boards, patches.node_ids(bus), send, complain=complain)
        self._patches, self._adaptive = patches, boards
        self._times = SendingTimes(contract, bus)
        self._decision = 0

    def tick(self, now_s: float) -> None:
        """Sample what is due, on all buses of the process; send what is most urgent; do what is due by time."""
        self._patches.advance(now_s)
        if now_s >= self._tick_at_s:
            self._tick_at_s = now_s + TICK_S
            self._post(self._boards.pass_time(now_s))
        if self._patches.decision != self._decision:
            self._decision = self._patches.decision
            now_ns = round(now_s * 1e9)
            times = self._times.next(now_ns, self._patches.pace_ns) if self._patches.has_due else None
            if times is not None:
                until_ns, most = times
                self._post(self._adaptive.choose(most, now_ns, until_ns))

    def _count(self, can_id: npt.NDArray[np.uint32], flags: npt.NDArray[np.uint8]) -> None:
        self.frames_sent += int((np.isin(can_id, self._pdo_ids) & (flags & (ECHO | ERROR) == ECHO)).sum())

    def _answer(self, part: Frames, counter: int, now_s: float) -> None:
        self._times.sync_ns = int(part[-1]["time_ns"])
        self._patches.touched_from(self._times.sync_ns - max(0, counter - 1) * self._times.period_ns)
        self._post(self._boards.take(part, now_s))
