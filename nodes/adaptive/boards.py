"""The adaptive boards of a process: all sample, filter and decide in one pass a millisecond."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from dbc import indices as od
from dbc.adaptive import SAVED_FRAMES, SendingRule
from dbc.adaptive_filter import Floats
from dbc.canopen import BASE_ID_MASK
from dbc.contract import Contract, frame_flags, sum_frame_bits
from dbc.frame import Frames, frame_bytes, frames
from nodes.adaptive.controllers import (
    DEFAULT_RULE,
    NO_COB_ID,
    REFUSED,
    SENT,
    choose,
    compile_all,
    decide_all,
    frame_buffer,
    give_back,
    new_controllers,
    take_echoes,
)
from nodes.adaptive.filtering import settled_filter
from nodes.adaptive.noise import Noise
from nodes.adaptive.patch_boards import MOST_FRAMES, PatchBoards
from nodes.adaptive.sending import ask, new_groups, noise_threshold_n2, present_codes
from skin.sources import TaxelSource
from skin.walsh import grouped_rows


class AdaptiveBoards(PatchBoards):
    """Some boards of a skin: sensors, filters, and what each has sent; parameters as for `PatchBoards`.

    Attributes
    ----------
    filter : PatchFilter
    groups : Groups
    controllers : Controllers
    """

    def __init__(self, contract: Contract, blocks: Sequence[int], source: TaxelSource, **analogue: Any) -> None:
        super().__init__(contract, blocks, source, **analogue)
        self._law = contract.law
        self.filter = settled_filter(lambda: self._sensors.sample(0), contract.phi.held[list(blocks)])
        compile_all(self._law)
        nodes, self._bus_of = len(blocks), {block: contract.nodes[block].bus for block in blocks}
        lines = [contract.layout.bus[bus] for bus in self._bus_of.values()]
        self._flags = {bus: frame_flags(contract.layout.bus[bus]) for bus in self._rows}
        self._node_ids = [node.node_id for node in contract.nodes]
        self._node_id = np.array([self._node_ids[block] for block in blocks], np.uint16)
        self._room, self._burst = frame_buffer(MOST_FRAMES), frames(MOST_FRAMES)
        #: Number of TPDOs · node + TPDO of an identifier on each bus, -1 for all others.
        self._place_of = {bus: np.full(BASE_ID_MASK + 1, -1, np.int64) for bus in self._rows}
        self._groups = contract.layout.groups
        self.groups = new_groups(nodes, self._groups, np.array([line.fd for line in lines]))
        bits = [[sum_frame_bits(line, self._groups, is_fine=is_fine) for is_fine in (False, True)] for line in lines]
        self.controllers = new_controllers(np.array(bits, np.int64).reshape(nodes, 2), self._groups)
        self._given = np.zeros((2, *self._cells.shape), np.float32)
        self._noise: Noise | None = None
        self._threshold_n2 = np.zeros(nodes)

    # --- time ----------------------------------------------------------------------------------------------

    @property
    def is_sending(self) -> bool:
        """Whether a controller may hold a frame, or its echo is to be read."""
        return bool(self.groups.under_way.any())

    def _take(self, sample_n: Floats) -> None:
        self.filter.take(sample_n)

    def _decide(self, now_ns: int, passed_ns: int, skipped: int) -> bool:  # noqa: ARG002  `decision` has the skipped ones
        if self.filter.noise is not self._noise:
            self._take_noise()
        due = decide_all(
            self.decision,
            now_ns,
            passed_ns * 1e-9,
            self.filter.sums_n,
            self.filter.variance_n2,
            self._threshold_n2,
            self._law,
            self.groups,
            self.controllers,
        )
        return bool(due)

    def _take_noise(self) -> None:
        self._noise = self.filter.noise
        self._threshold_n2 = noise_threshold_n2(
            self._noise.node_n, self.controllers.rule["noise_ratio"], self._phi.block_size
        )

    def place(self, block: int, site: int) -> None:
        """Let the board of a block sit on another block of the skin."""
        super().place(block, site)
        self._bus_of[block] = self._bus_of[site]
        self._node_id[self._row[block]] = self._node_ids[block]

    # --- frames ---------------------------------------------------------------------------------------------

    def set_operational(self, block: int, is_operational: bool) -> None:
        """Let a node send; it begins with all its groups. Or end that."""
        row = self._row[block]
        if is_operational and not self.controllers.is_operational[row]:
            for group in range(self._groups):
                ask(row, group, self.decision, self.groups)
        self.controllers.is_operational[row] = is_operational

    def set_tpdos(self, block: int, cob_id: Sequence[int], inhibit: Sequence[int]) -> None:
        """Set identifier, or `NO_COB_ID`, and inhibit time in samples of a node's TPDOs."""
        row, bus = self._row[block], self._bus_of[block]
        self.controllers.cob_id[row], self.controllers.inhibit[row] = cob_id, inhibit
        place_of, rows = self._place_of[bus], self._rows[bus]
        place_of[:] = -1
        for each in range(rows.start, rows.stop):
            of_node = self.controllers.cob_id[each]
            used = of_node != NO_COB_ID
            place_of[of_node[used]] = each * used.size + np.flatnonzero(used)

    def choose(self, bus: int, now_ns: int, until_ns: int, most: int) -> Frames:
        """Make the most urgent frames of the boards of a bus, at most `most`, which expire at `until_ns`."""
        rows, room = self._rows[bus], self._room
        if not self.controllers.has_due[rows].any():
            return self._burst[:0]
        parts = self.filter.sums_n, self._law, self.groups, self.controllers, room
        count = int(choose(rows.start, rows.stop, self.decision, until_ns, most, *parts))
        burst = self._burst[:count]
        burst["time_ns"], burst["expires_ns"], burst["flags"] = now_ns, until_ns, self._flags[bus]
        burst["can_id"], burst["port"] = room.can_id[:count], self._node_id[room.node[:count]]
        burst["length"], burst["data"] = room.length[:count], room.payload[:count]
        return burst

    def refuse(self, block: int, tpdo: int) -> None:
        """Take note of a frame of a TPDO that found no room in a transmit queue."""
        row = self._row[block]
        give_back(row, tpdo, self.groups, self.controllers)
        self.controllers.counts[row, REFUSED] += 1

    def take_echoes(self, bus: int, arrived: Frames) -> tuple[int, int]:
        """Take note of the nodes' own frames, see `nodes.adaptive.controllers.take_echoes`."""
        parts = self.decision, self._law, self.groups, self.controllers
        sent, others = take_echoes(frame_bytes(arrived), self._place_of[bus], *parts)
        return int(sent), int(others)

    # --- objects --------------------------------------------------------------------------------------------

    def forget(self, block: int) -> None:
        """Forget what a node has sent, as a reset does; it keeps what it has learned of its noise."""
        row = self._row[block]
        for mine, fresh in zip(self.groups, new_groups(1, self._groups, self.groups.is_fd[row]), strict=True):
            mine[row] = fresh[0]
        fresh_controllers = new_controllers(self.controllers.frame_bits[row : row + 1], self._groups)
        self.controllers.made_at[row] = fresh_controllers.made_at[0]
        self.controllers.counts[row] = 0
        self.controllers.is_operational[row] = False

    def frames_of(self, block: int) -> tuple[int, int]:
        """Return how many frames a node has sent since its reset, and how many found no room."""
        counts = self.controllers.counts[self._row[block]]
        return int(counts[SENT]), int(counts[REFUSED])

    def adjust(self, block: int, index: int, subindex: int, value: float) -> None:
        """Apply a write to a block's calibration, or to its way of sending (2030h to 2034h)."""
        row = self._row[block]
        if index == od.REFRESH:
            for group in range(self._groups):
                if int(value) >> group & 1:
                    ask(row, group, self.decision, self.groups)
        elif index == od.SENDING and subindex:
            self.controllers.rule[SendingRule._fields[subindex - 1]][row] = value
            self._noise = None
        elif index in (od.TAXEL_NOISE, od.COEFFICIENT_NOISE) and subindex:
            self._given[int(index == od.COEFFICIENT_NOISE), row, subindex - 1] = value
            self.filter.give(*self._given)
        elif index == od.BUDGET:
            self.controllers.budget[row] = value
            self.controllers.saved[row] = SAVED_FRAMES * self._groups * self.controllers.frame_bits[row, 0]
        else:
            super().adjust(block, index, subindex, value)
            self._sensors.is_stale = True

    def reset(self, block: int) -> None:
        """Set a block to the defaults: calibration, rule of sending, noise that is learned, no budget."""
        super().reset(block)
        row = self._row[block]
        self.controllers.rule[row] = DEFAULT_RULE
        self._noise, self._sensors.is_stale = None, True
        self.controllers.budget[row] = 0
        if self._given[:, row].any():
            self._given[:, row] = 0
            self.filter.give(*self._given)

    def read(self, block: int, index: int, subindex: int) -> float | None:
        """Return the present value of an object that the board computes (2030h, 2032h to 2035h, 2110h, 2111h)."""
        row, noise = self._row[block], self.filter.noise
        if index == od.REFRESH:
            return int(self.groups.is_wanted[row] @ (1 << np.arange(self._groups)))
        if index == od.NODE_NOISE:
            return float(noise.node_n[row])
        if not subindex:
            return None
        if index in (od.TAXEL_NOISE, od.COEFFICIENT_NOISE):
            of_index = noise.taxel_n if index == od.TAXEL_NOISE else noise.coefficient_n
            return float(of_index[row, subindex - 1])
        coarse, fine = present_codes(self.filter.sums_n[row], self._law, self.groups, row)
        return (
            int(coarse[subindex - 1]) if index == od.COARSE else int.from_bytes(fine[subindex - 1].tobytes(), "little")
        )

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
