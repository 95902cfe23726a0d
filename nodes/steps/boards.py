"""The stepped boards of a process: all sample and filter in one pass a millisecond, and decide in their slots."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from dbc import indices as od
from dbc.contract import Contract
from dbc.frame import Frames, frames
from dbc.patch_filter import Floats
from nodes.steps.filtering import settled_filter
from nodes.steps.patch_boards import PatchBoards
from nodes.steps.sending import Senders
from skin.sources import TaxelSource
from skin.walsh import grouped_rows


class SteppedBoards(PatchBoards):
    """Some boards of a skin: sensors, filters, and what each has sent; parameters as for `PatchBoards`.

    Attributes
    ----------
    filter : PatchFilter
    senders : Senders
    """

    def __init__(self, contract: Contract, blocks: Sequence[int], source: TaxelSource, **analogue: Any) -> None:
        super().__init__(contract, blocks, source, **analogue)
        self.filter = settled_filter(lambda: self._sensors.sample(0), contract.phi.held[list(blocks)])
        self.senders = Senders(contract)
        self.senders.slots.row[list(blocks)] = range(len(blocks))
        self._given = np.zeros((2, *self._cells.shape), np.float32)
        self._bursts: dict[int, Frames] = {}

    # --- time ----------------------------------------------------------------------------------------------

    @property
    def is_sending(self) -> bool:
        """Whether a controller may hold a frame, or its echo is to be read."""
        return self.senders.is_sending

    def _take(self, sample_n: Floats) -> None:
        self.filter.shows_pattern[:] = self._sensors.shows_pattern
        self.filter.take(sample_n)

    def _decide(self, now_ns: int) -> None:
        variance_n2 = self.filter.variances_n2(self.senders.rows_due(now_ns))
        known = self.filter.sums_n, variance_n2, self.filter.noise.node_n
        burst, bus = self.senders.take_slots(now_ns, *known)
        self._bursts = {each: burst[bus == each] for each in self._rows}

    def place(self, block: int, site: int) -> None:
        """Let the board of a block sit on another block of the skin."""
        super().place(block, site)
        self.senders.slots.row[block] = self._row[block]

    # --- frames ---------------------------------------------------------------------------------------------

    def at_sync(self, bus: int, counter: int, time_ns: int) -> None:
        """Begin the slots of a SYNC."""
        self.senders.take_sync(bus, counter, time_ns)
        super().at_sync(bus, counter, time_ns)

    def news(self, bus: int, now_s: float) -> Frames:  # noqa: ARG002  decided at the newest sample
        """Return the frames of the slots that have begun."""
        return self._bursts.pop(bus, frames(0))

    def count(
        self,
        bus: int,
        arrived: Frames,
        is_pdo: npt.NDArray[np.bool_],  # noqa: ARG002  the senders know their frames
    ) -> tuple[int, int, int]:
        """Take note of the nodes' own frames, see `Senders.take_echoes`."""
        sent, others = self.senders.take_echoes(bus, arrived)
        return sent, 0, others

    # --- objects --------------------------------------------------------------------------------------------

    def adjust(self, block: int, index: int, subindex: int, value: float) -> None:
        """Apply a write to a block's calibration, or to its way of sending (2030h to 2033h)."""
        if index == od.REFRESH:
            if value:
                self.senders.ask(block)
        elif index == od.SENDING and subindex == 1:
            self.senders.set_sending(block, quiet=value)
        elif index == od.SENDING and subindex == 2:
            self.senders.set_sending(block, slots=int(value))
        elif index == od.SENDING:
            self.senders.slots.offset_ns[block] = 1000 * int(value)
        elif index in (od.TAXEL_NOISE, od.COEFFICIENT_NOISE) and subindex:
            self._given[int(index == od.COEFFICIENT_NOISE), self._row[block], subindex - 1] = value
            self.filter.give(*self._given)
        else:
            super().adjust(block, index, subindex, value)
            self._sensors.is_stale = True

    def reset(self, block: int) -> None:
        """Set a block to the defaults: calibration, way of sending, noise that is learned."""
        super().reset(block)
        self.senders.reset(block)
        self._sensors.is_stale = True
        row = self._row[block]
        if self._given[:, row].any():
            self._given[:, row] = 0
            self.filter.give(*self._given)

    def read(self, block: int, index: int, subindex: int) -> float | None:
        """Return the present value of an object that the board computes (2022h, 2030h, 2032h to 2035h, 2110h)."""
        row, noise = self._row[block], self.filter.noise
        if index == od.SYNC_COUNTER:
            return self.senders.slot_byte(block)
        if index == od.REFRESH:
            return int(self.senders.is_asked(block))
        if index == od.NODE_NOISE:
            return float(noise.node_n[row])
        if not subindex:
            return None
        if index == od.WORDS:
            return self.senders.word(block, subindex - 1)
        of_index = noise.taxel_n if index == od.TAXEL_NOISE else noise.coefficient_n
        return float(of_index[row, subindex - 1])

    @property
    def sums(self) -> npt.NDArray[np.int32]:
        """The sums of the filtered forces in counts, in the order of Φ, shape (m,); those of other boards are 0."""
        sums = np.zeros(self._phi.shape[0], np.int32)
        size, order = self._phi.block_size, grouped_rows(self._phi.block_size).ravel()
        most = size * self._taxels.count_max  # a forecast may exceed what taxels can read, and a sum its type
        for block, row in self._row.items():
            counts = np.rint(self.filter.sums_n[row] / self._taxels.newton_per_count)
            sums[block * size + order] = np.clip(counts, -most, most)
        return sums
