"""The stepped boards of a process by their clock: all sample in one pass a millisecond."""

from abc import abstractmethod
from collections import deque
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from canskin.messages import Truth
from dbc.contract import Contract
from dbc.patch_filter import SAMPLE_NS, Floats
from nodes.electronics import Calibration
from nodes.hardware import Hardware
from nodes.steps.sensors import STEP_NS, PatchSensors
from skin.defects import NO_DEFECTS, Defects
from skin.sources import TaxelSource
from skin.taxel import NOISE_N, TaxelModel

#: Most samples that a late process takes at once; it skips the others.
CATCH_UP: Final = 20


class PatchBoards(Hardware):
    """Some boards of a skin, and the sensors of their patches; a TPDO counts as sent when its echo comes.

    Parameters
    ----------
    contract : Contract
        Of a layout with steps.
    blocks : sequence of int
        The blocks of these boards, ascending.
    source : TaxelSource
        Touch in steps of 10 ms.
    noise_n, defects, seed
        As for `nodes.electronics.Electronics`.
    """

    counts_accepted = False

    def __init__(
        self,
        contract: Contract,
        blocks: Sequence[int],
        source: TaxelSource,
        *,
        noise_n: float = NOISE_N,
        seed: int = 0,
        defects: Defects = NO_DEFECTS,
    ) -> None:
        taxels = contract.layout.taxels
        super().__init__(contract.phi, Calibration(taxels, contract.phi.wired.taxels))
        self._taxels = taxels
        self._row_of_site = {block: row for row, block in enumerate(blocks)}
        #: The board that is that of a block.
        self._row = dict(self._row_of_site)
        #: Which of these boards are those of each bus.
        self._rows: dict[int, slice] = {}
        for row, block in enumerate(blocks):
            bus = contract.nodes[block].bus
            self._rows[bus] = slice(self._rows[bus].start if bus in self._rows else row, row + 1)
        self._cells = contract.phi.taxels_of_blocks[list(blocks)]
        model = TaxelModel(0.0 if source.has_noise else noise_n, taxels.force_max_n, defects)
        self._sensors = PatchSensors(self._calibration, self._cells, model, source, seed)
        self._next_ns, self._period_ns = 0, round(contract.layout.sync.period_s * 1e9)
        self._truths: deque[Truth] = deque(maxlen=CATCH_UP)

    @property
    def due_s(self) -> float:
        """When the next sample is due; before the first call of `advance`, at once."""
        return self._next_ns * 1e-9

    def prepare(self) -> None:
        """Do nothing: no SYNC asks for anything."""

    def begin(self, now_s: float, since_sync_s: float) -> bool:  # noqa: ARG002  heartbeats may go at any time
        """Sample what is due, on all buses of the process."""
        self.advance(now_s)
        return True

    def at_sync(self, bus: int, counter: int, time_ns: int) -> None:  # noqa: ARG002  all buses have one touch
        """Heed a SYNC: the first tells when the touch begins, its step 0 with counter 1."""
        if self._sensors.touch_from_ns is None:
            self._sensors.touch_from_ns = time_ns - max(0, counter - 1) * self._period_ns

    def advance(self, now_s: float) -> None:
        """Take all samples that are due, and decide what the nodes send whose slots have begun."""
        now_ns = round(now_s * 1e9)
        if not self._next_ns:
            self._next_ns = now_ns
        due = (now_ns - self._next_ns) // SAMPLE_NS + 1
        if due <= 0:
            return
        skipped = max(0, due - CATCH_UP)
        self._next_ns += skipped * SAMPLE_NS
        for _ in range(due - skipped):
            self._take(self._sensors.sample(self._next_ns))
            self._note_truth(self._next_ns)
            self._next_ns += SAMPLE_NS
        self._decide(now_ns)

    def place(self, block: int, site: int) -> None:
        """Let the board of a block sit on another block of the skin: it is the board of that row."""
        super().place(block, site)
        self._row[block] = self._row_of_site[site]

    @abstractmethod
    def _take(self, sample_n: Floats) -> None:
        """Take one sample of every taxel, newtons, shape (boards, taxels); `_sensors.counts` has it in counts."""

    @abstractmethod
    def _decide(self, now_ns: int) -> None:
        """Decide with the newest sample what the nodes send whose slots have begun."""

    def _note_truth(self, tick_ns: int) -> None:
        """Keep the truth of a step that this tick is the first after."""
        begin_ns = self._sensors.touch_from_ns
        if begin_ns is None or tick_ns < begin_ns or (tick_ns - begin_ns) % STEP_NS >= SAMPLE_NS:
            return
        step = (tick_ns - begin_ns) // STEP_NS
        frame = self._sensors.frame(step)
        sensor_n = np.zeros(self._calibration.gain.size, "<f4")
        sensor_n[self._cells] = self._sensors.counts * np.float32(self._taxels.newton_per_count)
        self._truths.append(
            Truth(
                step=step,
                sync_counter=0,
                sampled_mono_ns=begin_ns + step * STEP_NS,
                true=frame.force_n.astype("<f4").tobytes(),
                sensor=sensor_n[: self._taxels.count].tobytes(),
                label=frame.label,
            )
        )

    def _drifted_n(self) -> Floats:
        return self._sensors.drifted_n(self._next_ns)

    def take_truth(self) -> Truth | None:
        """Return the oldest truth that was not returned yet."""
        return self._truths.popleft() if self._truths else None

    def counts(self, block: int) -> Any:
        """Return what the taxels of a block read last, in counts."""
        return self._sensors.counts[self._row[block]].astype(np.int32)
