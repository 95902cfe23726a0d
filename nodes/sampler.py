"""At a SYNC every block samples the same instant of the touch."""

from collections import deque
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from canskin.messages import Truth
from dbc.canopen import BASE_ID_MASK
from dbc.frame import ECHO, ERROR, Frames
from nodes.analogue import AnalogueElectronics
from nodes.electronics import Electronics
from nodes.hardware import Hardware
from skin.layout import Layout
from skin.phi import Sbhe
from skin.sources import Frame, TaxelSource
from skin.sync_counter import SYNC_OVERFLOW

#: Longest time between the SYNC frames of one cycle, with the same counter, on different buses. A busy master delays
#: frames. A counter returns after 240 periods, 120 ms or more.
NUMBERED_SYNC_SPREAD_NS: Final = 100_000_000
#: Cycles whose sums are kept, because some buses are read later than others.
KEPT_CYCLES: Final = 8
#: The next SYNC is expected within these times after the last SYNC, in periods.
QUIET_FROM: Final = 0.7
QUIET_TO: Final = 2.0


@dataclass(frozen=True)
class _Cycle:
    """The sums of a cycle, for the buses that have not asked for them yet.

    `counter` is that of SYNC, 0 for a SYNC without counter.
    """

    counter: int
    time_ns: int
    sums: npt.NDArray[np.int32]
    buses: set[int] = field(default_factory=set)


@dataclass(frozen=True)
class _Ahead:
    """What the boards will answer at a step, unless a write changes it, and what their taxels read then."""

    step: int
    frame: Frame
    sums: npt.NDArray[np.int32]
    sampled: npt.NDArray[np.int32]


class Sampler(Hardware):
    """Turns SYNCs into sums, once per cycle for all buses.

    The step of the taxel source follows the SYNC counter. So all processes of nodes that were started before the first
    SYNC measure the same touch, even if one misses a SYNC. A SYNC without counter, another master's, is no step.
    """

    counts_accepted = True

    def __init__(self, phi: Sbhe, source: TaxelSource, electronics: Electronics) -> None:
        super().__init__(phi, electronics)
        self._sums = np.zeros(phi.shape[0], np.int32)
        self._source = source
        self._electronics = electronics
        self._step = -1
        self._counter = 0
        self._kept: deque[_Cycle] = deque(maxlen=KEPT_CYCLES)
        #: Counter of the newest cycle of each bus.
        self._newest: dict[int, int] = {}
        self._truth: Truth | None = None
        self._ahead: _Ahead | None = None
        #: Where boards have exchanged their sites: the taxel that is felt in place of each, shape (places,).
        self._felt: npt.NDArray[np.intp] | None = None

    @property
    def sums(self) -> npt.NDArray[np.int32]:
        """The newest sums, shape (m,)."""
        return self._sums

    def counts(self, block: int) -> npt.NDArray[np.int32]:
        """Return what the taxels of a block read last, in counts."""
        return self._electronics.sampled[self._chain(block)]

    def place(self, block: int, site: int) -> None:
        """Let the board of a block sit on another block of the skin: it feels the taxels there."""
        self._drop_answer()
        super().place(block, site)
        chains = self._phi.taxels_of_blocks
        self._felt = np.arange(self._phi.taxels)
        self._felt[chains] = chains[self._sites]

    def adjust(self, block: int, index: int, subindex: int, value: float) -> None:
        """Apply a write to a block's calibration or test pattern (2010h, 2011h, 2021h)."""
        self._drop_answer()
        super().adjust(block, index, subindex, value)

    def reset(self, block: int) -> None:
        """Set a block to the defaults, and begin its averages anew."""
        self._drop_answer()
        super().reset(block)
        self._electronics.restart(int(self._sites[block]))

    def begin(self, now_s: float, since_sync_s: float) -> bool:  # noqa: ARG002  a SYNC tells when to sample
        """Tell whether no SYNC is expected.

        A heartbeat sent while a SYNC waits to be read would delay the burst that answers this SYNC.
        """
        period_s = self._electronics.period_s
        return not QUIET_FROM * period_s < since_sync_s < QUIET_TO * period_s

    def at_sync(self, bus: int, counter: int, time_ns: int) -> npt.NDArray[np.int32]:
        """Sample all taxels."""
        return self.sample(counter, time_ns, bus)

    def count(
        self,
        bus: int,  # noqa: ARG002  `is_pdo` is that of the bus
        arrived: Frames,
        is_pdo: npt.NDArray[np.bool_],
    ) -> tuple[int, int, int]:
        """Count the TPDOs that could not be sent within the window (1007h); nobody needs the others' echoes."""
        flags = arrived["flags"]
        own = flags[(flags & ECHO != 0) & is_pdo[arrived["can_id"] & BASE_ID_MASK]]
        dropped = int(np.count_nonzero(own & ERROR))
        return -dropped, dropped, len(arrived) - (len(own) - dropped)

    def sample(self, counter: int, time_ns: int, bus: int = 0) -> npt.NDArray[np.int32]:
        """Return the sums, shape (m,), at the SYNC `counter` (0: a SYNC without counter) seen on `bus` at `time_ns`."""
        cycle = self._known(counter, time_ns, bus)
        if cycle is None:
            cycle = _Cycle(counter, time_ns, self._begin(counter, time_ns))
            self._kept.append(cycle)
        cycle.buses.add(bus)
        self._newest[bus] = counter
        return cycle.sums

    def _known(self, counter: int, time_ns: int, bus: int) -> _Cycle | None:
        """Return a kept cycle; a bus that has had others since has a master that begins to count anew."""
        for cycle in reversed(self._kept):
            if cycle.counter == counter and abs(time_ns - cycle.time_ns) < NUMBERED_SYNC_SPREAD_NS:
                return None if bus in cycle.buses and self._newest[bus] != counter else cycle
        return None

    def _begin(self, counter: int, time_ns: int) -> npt.NDArray[np.int32]:
        """Sample a cycle; return its sums."""
        if not counter:
            step = max(self._step, 0)
        elif self._step < 0:
            step = counter - 1
        else:
            step = self._step + ((counter - self._counter) % SYNC_OVERFLOW or 1)
        if self._ahead is not None and self._ahead.step == step:
            frame, self._sums, self._electronics.sampled = self._ahead.frame, self._ahead.sums, self._ahead.sampled
            self._ahead = None
        else:
            self._drop_answer()
            if 0 <= self._step < step - 1 and self._electronics.averages:
                self._electronics.prepare(self._source.frame(step - 1).force_n, step - 1)
            frame = self._source.frame(step)
            self._sums = self._answer(frame.force_n, step)
        self._step, self._counter = step, counter or self._counter
        self._truth = self._electronics.truth(frame, self._step, counter, time_ns)
        return self._sums

    def _answer(self, force_n: npt.NDArray[np.float32], step: int) -> npt.NDArray[np.int32]:
        """Return what the boards answer with at `step`: the sums, shape (m,)."""
        read = self._electronics.read(force_n, step)
        exact: npt.NDArray[Any] = self._phi.forward(read if self._felt is None else read[self._felt])
        sums: npt.NDArray[np.int32] = np.rint(exact).astype(np.int32)
        return sums

    def prepare(self) -> None:
        """Make the answer that the next SYNC will most likely ask for."""
        step = self._step + 1
        if step > 0 and self._ahead is None:
            sampled, frame = self._electronics.sampled, self._source.frame(step)
            sums = self._answer(frame.force_n, step)
            self._ahead = _Ahead(step, frame, sums, self._electronics.sampled)
            self._electronics.sampled = sampled  # until then

    def _drifted_n(self) -> npt.NDArray[np.float32]:
        return self._electronics.drifted_n(self._step)

    def _drop_answer(self) -> None:
        """Make the next answer anew, from the same samples of the taxels."""
        if self._ahead is not None:
            self._electronics.sampled_ahead = self._ahead.step
            self._ahead = None

    def take_truth(self) -> Truth | None:
        """Return the true forces and the sensor signal of the newest cycle, once."""
        truth, self._truth = self._truth, None
        return truth


class AnalogueSampler(Sampler):
    """A sampler for boards whose sums are made before the converters."""

    def __init__(self, phi: Sbhe, source: TaxelSource, electronics: AnalogueElectronics) -> None:
        super().__init__(phi, source, electronics)
        self._analogue = electronics

    def saturated(self, block: int) -> int:
        """Count the sums of `block` at an end of their range."""
        first, last = self._phi.starts[block : block + 2]
        return int(self._analogue.converter.is_saturated(self._sums[first:last]).sum())

    def _answer(self, force_n: npt.NDArray[np.float32], step: int) -> npt.NDArray[np.int32]:
        later_n = self._source.frame(step + 1).force_n if self._analogue.is_skewed else None
        return self._analogue.read_sums(force_n, later_n, step)


class CountSampler(Sampler):
    """A sampler for boards that make the sums themselves.

    `sample` returns ADC counts, shape (samples, n), row-major, since the cycle before; the last sample is at the SYNC.
    """

    def prepare(self) -> None:
        """Sample ahead what the next SYNC will most likely ask for: the boards make the sums."""
        step = self._step + 1
        if step > 0 and step != self._electronics.sampled_ahead:
            self._electronics.prepare(self._source.frame(step).force_n, step)

    def _answer(self, force_n: npt.NDArray[np.float32], step: int) -> npt.NDArray[np.int32]:
        self._electronics.read(force_n, step)
        counts = np.concatenate(self._electronics.unread)
        self._electronics.unread.clear()
        return counts


class CodeSampler(AnalogueSampler):
    """A sampler for boards that make the sums of their converters' codes: `sample` returns codes, shape (1, m)."""

    def _answer(self, force_n: npt.NDArray[np.float32], step: int) -> npt.NDArray[np.int32]:
        return super()._answer(force_n, step)[None] // self._analogue.converter.step_counts


def new_sampler(layout: Layout, phi: Sbhe, source: TaxelSource, *, makes_sums: bool = True, **analogue: Any) -> Sampler:
    """Return the sampler of a skin, with all code compiled.

    Parameters
    ----------
    phi : Sbhe
        Of the layout.
    makes_sums : bool
        Whether it returns sums; else what the converters read, for boards that make the sums of it.
    **analogue
        ``noise_n``, ``seed`` and ``defects`` of `Electronics`.
    """

    def new() -> Sampler:
        if layout.taxels.is_analogue:
            kind = AnalogueSampler if makes_sums else CodeSampler
            return kind(phi, source, AnalogueElectronics(layout, phi, **analogue))
        electronics = Electronics(
            layout.taxels,
            **analogue,
            period_s=layout.sync.period_s,
            samples=layout.samples_per_sync,
            blocks=phi.taxels_of_blocks if makes_sums else None,
            places=phi.wired.taxels,
        )
        return (Sampler if makes_sums else CountSampler)(phi, source, electronics)

    # A first start compiles for a while: before the nodes are there, and not between two SYNCs.
    new().sample(1, 0)
    return new()
