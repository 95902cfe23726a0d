"""The adaptive boards of a process: all sample, filter and decide in one pass a millisecond."""

from collections import deque
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from dbc.adaptive import SAVED_FRAMES, TPDOS, SendingRule
from dbc.contract import Contract, sum_frame_bits
from dbc.frame import Frames, frame_bytes
from dbc.indices import (
    OD_BUDGET,
    OD_COARSE,
    OD_COEFFICIENT_NOISE,
    OD_NODE_NOISE,
    OD_REFRESH,
    OD_SENDING,
    OD_TAXEL_NOISE,
)
from nodes.adaptive.filtering import PatchFilter
from nodes.adaptive.mailboxes import (
    REFUSED,
    SENT,
    Chosen,
    choose,
    compile_all,
    give_back,
    look_at_all,
    new_mailboxes,
    take_echoes,
)
from nodes.adaptive.noise import IdleStatistics, Noise
from nodes.adaptive.sending import ask, new_groups, noise_threshold_n2, present_codes
from nodes.adaptive.sensors import SAMPLE_NS, STEP_NS, PatchSensors
from nodes.boards import Boards
from nodes.electronics import Calibration
from skin.messages import Truth
from skin.sources import TaxelSource
from skin.taxel import NOISE_N, TaxelModel
from skin.walsh import GROUPS, grouped_rows

#: Samples of the idle skin that a board learns from when it is switched on, and that its filter has then seen.
IDLE_SAMPLES: Final = 2000
SETTLING_SAMPLES: Final = 300
#: A process that is late takes at most so many samples at once; it skips and counts the others.
CATCH_UP: Final = 20
#: How fast the time between two decisions is learned, and its limits, nanoseconds.
PACE_GAIN: Final = 0.1
PACE_NS: Final = (SAMPLE_NS, CATCH_UP * SAMPLE_NS)
_DEFAULTS: Final = tuple(float(value) for value in SendingRule())


class AdaptiveBoards(Boards):
    """Some boards of a skin: sensors, filters, and what each has sent.

    Parameters
    ----------
    contract : Contract
        Of a layout with adaptive sending.
    blocks : sequence of int
        The blocks of these boards, ascending.
    source : TaxelSource
        Touch in steps of 10 ms.
    noise_n, defects, seed
        As for `nodes.electronics.Electronics`.

    Attributes
    ----------
    samples_skipped : int
        Samples that were not taken, because the process was late.
    has_due : bool
        Whether any node had something to send at the newest decision.
    """

    def __init__(
        self,
        contract: Contract,
        blocks: Sequence[int],
        source: TaxelSource,
        *,
        noise_n: float = NOISE_N,
        seed: int = 0,
        defects: dict[str, Any] | None = None,
    ) -> None:
        taxels = contract.layout.taxels
        super().__init__(contract.phi, Calibration(taxels))
        self.samples_skipped = 0
        self._taxels, self._law = taxels, contract.law
        self._row = {block: row for row, block in enumerate(blocks)}
        self._cells = contract.phi.taxels_of_blocks[list(blocks)]
        model = TaxelModel(0.0 if source.has_noise else noise_n, taxels.force_max_n, **(defects or {}))
        self._sensors = PatchSensors(self._calibration, self._cells, model, source, seed)
        self._filter = PatchFilter(self._learn())
        for _ in range(SETTLING_SAMPLES):
            self._filter.take(self._sensors.sample(0))
        compile_all(self._law)
        nodes, lines = len(blocks), [contract.layout.bus[contract.nodes[block].bus] for block in blocks]
        self._groups = new_groups(nodes, np.array([line.fd for line in lines]))
        bits = [[sum_frame_bits(line, is_fine=is_fine) for is_fine in (False, True)] for line in lines]
        self._boxes = new_mailboxes(np.array(bits, np.int64).reshape(nodes, 2))
        self._rules = np.tile(np.array(_DEFAULTS), (nodes, 1))
        self._given = np.zeros((2, *self._cells.shape), np.float32)
        self._is_operational, self._has_due = np.zeros((2, nodes), np.bool_)
        self._noise: Noise | None = None
        self._threshold_n2 = np.zeros(nodes)
        self._is_changed = self.has_due = False
        self._now = 0  # number of the newest sample
        self._next_ns = self._decided_ns = 0
        self._pace_ns = float(SAMPLE_NS)
        self._truths: deque[Truth] = deque(maxlen=CATCH_UP)

    def _learn(self) -> Noise:
        """Learn the noise of the untouched skin, as a board does when it is switched on."""
        statistics = IdleStatistics(*self._cells.shape)
        for _ in range(IDLE_SAMPLES):
            statistics.take(self._sensors.sample(0))
        return statistics.noise(self._taxels.newton_per_count)

    # --- time ----------------------------------------------------------------------------------------------

    @property
    def due_s(self) -> float:
        """When the next sample is due; before the first call of `advance`, at once."""
        return self._next_ns * 1e-9

    @property
    def decision(self) -> int:
        """Number of the sample at which was last decided what to send."""
        return self._now

    @property
    def pace_ns(self) -> float:
        """Time between two decisions: that of a sample, unless the process is late."""
        return self._pace_ns

    @property
    def is_sending(self) -> bool:
        """Whether a controller may hold a frame, or its echo is to be read."""
        return bool(self._groups.under_way.any())

    def prepare(self) -> None:
        """Do nothing: no SYNC asks for anything."""

    def touched_from(self, time_ns: int) -> None:
        """Let the touch begin, if it has not: its step 0 is at `time_ns`."""
        if self._sensors.touch_from_ns is None:
            self._sensors.touch_from_ns = time_ns

    def advance(self, now_s: float) -> None:
        """Take all samples that are due, and decide once what each node is to send."""
        now_ns = round(now_s * 1e9)
        if not self._next_ns:
            self._next_ns = self._decided_ns = now_ns
        due = (now_ns - self._next_ns) // SAMPLE_NS + 1
        if due <= 0:
            return
        if due > CATCH_UP:
            skipped = due - CATCH_UP
            self.samples_skipped += skipped
            self._next_ns += skipped * SAMPLE_NS
        if self._is_changed:
            self._sensors.recalibrate()
            self._is_changed = False
        for _ in range(min(due, CATCH_UP)):
            self._filter.take(self._sensors.sample(self._next_ns))
            self._note_truth(self._next_ns)
            self._next_ns += SAMPLE_NS
        self._now += due
        self._decide(now_ns)

    def _decide(self, now_ns: int) -> None:
        if self._filter.noise is not self._noise:
            self._take_noise()
        passed_ns = now_ns - self._decided_ns
        self._decided_ns = now_ns
        self._pace_ns += PACE_GAIN * (min(max(passed_ns, PACE_NS[0]), PACE_NS[1]) - self._pace_ns)
        self.has_due = look_at_all(
            self._now,
            now_ns,
            passed_ns * 1e-9,
            self._is_operational,
            self._filter.sums_n,
            self._filter.variance_n2,
            self._threshold_n2,
            self._rules,
            self._law,
            self._groups,
            self._boxes,
            self._has_due,
        )

    def _take_noise(self) -> None:
        self._noise = self._filter.noise
        ratio = self._rules[:, SendingRule._fields.index("noise_ratio")]
        self._threshold_n2 = noise_threshold_n2(self._noise.node_n, ratio)

    def _note_truth(self, tick_ns: int) -> None:
        """Keep the truth of a step that this tick is the first after."""
        begin_ns = self._sensors.touch_from_ns
        if begin_ns is None or tick_ns < begin_ns or (tick_ns - begin_ns) % STEP_NS >= SAMPLE_NS:
            return
        step = (tick_ns - begin_ns) // STEP_NS
        frame = self._sensors.frame(step)
        sensor_n = np.zeros(self._taxels.count, "<f4")
        sensor_n[self._cells] = self._sensors.counts * np.float32(self._taxels.newton_per_count)
        self._truths.append(
            Truth(
                step=step,
                sync_counter=0,
                sampled_mono_ns=begin_ns + step * STEP_NS,
                true=frame.force_n.astype("<f4").tobytes(),
                sensor=sensor_n.tobytes(),
                label=frame.label,
            )
        )

    def take_truth(self) -> Truth | None:
        """Return the oldest truth that was not returned yet."""
        return self._truths.popleft() if self._truths else None

    # --- frames ---------------------------------------------------------------------------------------------

    def row(self, block: int) -> int:
        """Return the place of a block among these boards."""
        return self._row[block]

    def set_operational(self, block: int, is_operational: bool) -> None:
        """Let a node send; it begins with all its groups. Or end that."""
        row = self._row[block]
        if is_operational and not self._is_operational[row]:
            for group in range(GROUPS):
                ask(row, group, self._now, self._groups)
        self._is_operational[row] = is_operational

    def set_tpdos(self, block: int, cob_id: Sequence[int], inhibit: Sequence[int]) -> None:
        """Set identifier, or `NO_COB_ID`, and inhibit time in samples of a node's TPDOs."""
        row = self._row[block]
        self._boxes.cob_id[row], self._boxes.inhibit[row] = cob_id, inhibit

    def choose(self, first: int, last: int, until_ns: int, most: int, room: Chosen) -> int:
        """Make the most urgent frames of boards `first` to `last` - 1, at most `most`, and return how many."""
        if not self._has_due[first:last].any():
            return 0
        parts = self._filter.sums_n, self._law, self._groups, self._boxes, self._has_due, room
        return int(choose(first, last, self._now, until_ns, most, *parts))

    def refuse(self, nodes: npt.NDArray[np.int64], tpdos: npt.NDArray[np.int64]) -> None:
        """Take note of frames that found no room in a transmit queue."""
        for row, tpdo in zip(nodes.tolist(), tpdos.tolist(), strict=True):
            give_back(row, tpdo, self._groups, self._boxes)
            self._boxes.counts[row, REFUSED] += 1

    def take_echoes(self, arrived: Frames, place_of: npt.NDArray[np.int64]) -> tuple[int, int]:
        """Take note of the nodes' own frames, see `nodes.adaptive.mailboxes.take_echoes`."""
        parts = self._now, self._rules, self._law, self._groups, self._boxes
        sent, others = take_echoes(frame_bytes(arrived), place_of, *parts)
        return int(sent), int(others)

    # --- objects --------------------------------------------------------------------------------------------

    def forget(self, block: int) -> None:
        """Forget what a node has sent, as a reset does; it keeps what it has learned of its noise."""
        row = self._row[block]
        for mine, fresh in zip(self._groups, new_groups(1, self._groups.is_fd[row]), strict=True):
            mine[row] = fresh[0]
        self._boxes.made_at[row] = new_mailboxes(self._boxes.frame_bits[row : row + 1]).made_at[0]
        self._boxes.counts[row] = 0
        self._is_operational[row] = False

    def frames_of(self, block: int) -> tuple[int, int]:
        """Return how many frames a node has sent since its reset, and how many found no room."""
        counts = self._boxes.counts[self._row[block]]
        return int(counts[SENT]), int(counts[REFUSED])

    def adjust(self, block: int, index: int, subindex: int, value: float) -> None:
        """Apply a write to a block's calibration, or to its way of sending (2030h to 2034h)."""
        row = self._row[block]
        self._is_changed = True
        if index == OD_REFRESH:
            for group in range(GROUPS):
                if int(value) >> group & 1:
                    ask(row, group, self._now, self._groups)
        elif index == OD_SENDING and subindex:
            self._rules[row, subindex - 1] = value
            self._noise = None
        elif index in (OD_TAXEL_NOISE, OD_COEFFICIENT_NOISE) and subindex:
            self._given[int(index == OD_COEFFICIENT_NOISE), row, subindex - 1] = value
            self._filter.give(*self._given)
        elif index == OD_BUDGET:
            self._boxes.budget[row] = value
            self._boxes.saved[row] = SAVED_FRAMES * self._boxes.frame_bits[row, 0]
        else:
            super().adjust(block, index, subindex, value)

    def reset(self, block: int) -> None:
        """Set a block to the defaults: calibration, rule of sending, noise that is learned, no budget."""
        super().reset(block)
        row = self._row[block]
        self._rules[row] = _DEFAULTS
        self._noise, self._is_changed = None, True
        self._boxes.budget[row] = 0
        if self._given[:, row].any():
            self._given[:, row] = 0
            self._filter.give(*self._given)

    def read(self, block: int, index: int, subindex: int) -> float | None:
        """Return the present value of an object that the board computes (2030h, 2032h to 2035h, 2110h, 2111h)."""
        row, noise = self._row[block], self._filter.noise
        if index == OD_REFRESH:
            return int(self._groups.is_wanted[row] @ (1 << np.arange(GROUPS)))
        if index == OD_NODE_NOISE:
            return float(noise.node_n[row])
        if not subindex:
            return None
        if index in (OD_TAXEL_NOISE, OD_COEFFICIENT_NOISE):
            of_index = noise.taxel_n if index == OD_TAXEL_NOISE else noise.coefficient_n
            return float(of_index[row, subindex - 1])
        coarse, fine = present_codes(self._filter.sums_n[row], self._law, self._groups, row)
        return (
            int(coarse[subindex - 1]) if index == OD_COARSE else int.from_bytes(fine[subindex - 1].tobytes(), "little")
        )

    def counts(self, block: int) -> npt.NDArray[np.int32]:
        """Return what the taxels of a block read last, in counts."""
        counts: npt.NDArray[np.int32] = self._sensors.counts[self._row[block]].astype(np.int32)
        return counts

    @property
    def sums(self) -> npt.NDArray[np.int32]:
        """The sums of the filtered forces in counts, in the order of Φ, shape (m,); those of other boards are 0."""
        sums = np.zeros(self._phi.shape[0], np.int32)
        size, order = self._phi.block_size, grouped_rows(self._phi.block_size).ravel()
        for block, row in self._row.items():
            sums[block * size + order] = np.rint(self._filter.sums_n[row] / self._taxels.newton_per_count)
        return sums


def tpdo_places(cob_ids: npt.NDArray[np.int64], first: int, places: npt.NDArray[np.int64]) -> None:
    """Write which TPDO an identifier belongs to: `cob_ids` of shape (nodes, TPDOS), of boards from `first` on."""
    places[:] = -1
    for row, of_node in enumerate(cob_ids, first):
        used = of_node > 0
        places[of_node[used]] = row * TPDOS + np.flatnonzero(used)
