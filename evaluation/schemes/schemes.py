"""The schemes: what each sends of a touch, how late, and what its receiver shows."""

from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Final, Literal

import numpy as np
from msgspec.structs import replace

from dbc.contract import Contract
from evaluation.result import Row
from evaluation.schemes.adaptive import filtered_counts, idle_of, less_variation, run_adaptive
from evaluation.schemes.events import run_events
from evaluation.schemes.judge import Images, Updates, quality
from evaluation.schemes.scan import CELLS_PENALTY_N, SCAN_PENALTY_N, ScanRun, refined, run_scan, smoothed
from evaluation.schemes.scenes import NEWTON_PER_COUNT, SIDE, TAXELS, Scene, Touch
from evaluation.schemes.sums import run_sums
from evaluation.schemes.wire import TICK_NS, Nanoseconds, Sent, lines_of
from skin.layout import load_layout
from touch.coarse_arrays import averaged
from touch.contact import Force

FD_BITRATE: Final = 5_000_000
#: Bits of a value of a scan: the converter's.
SCAN_BITS: Final = 10
#: Nothing is sampled more often than the recorded touches are.
SCAN_RATE_MAX_HZ: Final = 500.0
#: A scan is tried at this rate, to learn what one of this touch takes.
TRIAL_HZ: Final = 20.0
#: Bilinear splines for values as they came, bicubic ones for what is smooth already.
_PLAIN_ORDER, _SOLVED_ORDER = 1, 3


@dataclass(frozen=True, eq=False)
class Shown:
    """What a scheme sent of a touch, and what its receiver had in use.

    Attributes
    ----------
    sent : Sent
        All frames.
    latency_ns : array of int64, shape (values,)
        From the sample to the end of the frame that brings it.
    images : Images or Updates
        What is in use.
    rate_hz : float, optional
        How often all is sent; None for what goes by events.
    """

    sent: Sent
    latency_ns: Nanoseconds
    images: Images | Updates
    rate_hz: float | None

    def figures(self, what: Scene) -> Row:
        """Return bits, loads, latencies in ms, and `evaluation.schemes.judge.quality` against the touch's truth."""
        late = {
            "latency_p99_ms": float(np.percentile(self.latency_ns, 99)) * 1e-6 if len(self.latency_ns) else 0.0,
            "latency_worst_ms": float(self.latency_ns.max()) * 1e-6 if len(self.latency_ns) else 0.0,
        }
        return self.sent.traffic() | late | quality(what.true_n, self.images) | {"rate_hz": self.rate_hz}


@dataclass(frozen=True)
class Adaptive:
    """Adaptive sums: one setting for every touch; noise is learned from the idle skin.

    `is_fd`: on CAN FD buses of 1 and 5 Mbit/s in place of classic ones.
    """

    is_fd: bool = False

    @property
    def name(self) -> str:
        """What it is called in a table."""
        return "adaptive sums" + (", CAN FD" if self.is_fd else "")

    def show(self, touch: Touch) -> Shown:
        """Send the news of `touch`, with whatever bits they take."""
        lines = [replace(line, fd=True, data_bitrate=FD_BITRATE) if self.is_fd else line for line in lines_of(SIDE)]
        run = run_adaptive(touch.load().counts, idle_of(touch), lines)
        return Shown(run.sent, run.latency_ns, run.images(touch.arrives(len(run.sent.frames))), None)


@dataclass(frozen=True)
class Sums:
    """The default skin."""

    @property
    def name(self) -> str:
        """What it is called in a table."""
        return "sums"

    def show(self, touch: Touch) -> Shown:
        """Measure `touch` in every cycle."""
        contract = Contract.from_layout(load_layout())
        run = run_sums(contract, touch.load().counts, touch.loss_ratio, touch.seed, touch.idle())
        return Shown(run.sent, run.latency_ns, run.images(contract), contract.layout.sync.rate_hz)


@dataclass(frozen=True)
class Scan:
    """An array of `side` x `side` cells, every value sent in turn, as often as the default skin's bits allow.

    `side` is that of the skin, or a coarse array's.
    """

    side: int
    receiver: Literal["plain", "solved"] = "plain"

    @property
    def name(self) -> str:
        """What it is called in a table."""
        name = "scan" if self.side == SIDE else f"{self.side} x {self.side}"
        return name + ("" if self.receiver == "plain" else ", solved")

    def show(self, touch: Touch) -> Shown:
        """Scan `touch`."""
        felt_n = self._felt_n(touch)
        trial = run_scan(felt_n, SCAN_BITS, TRIAL_HZ).sent.traffic()["kbit_per_s"]
        rate_hz = min(SCAN_RATE_MAX_HZ, TRIAL_HZ * default_kbit_per_s() / trial)
        run = run_scan(felt_n, SCAN_BITS, rate_hz)
        return Shown(run.sent, run.latency_ns, self._received(run, touch), rate_hz)

    def _felt_n(self, touch: Touch) -> Force:
        """Return what the cells feel, newtons, shape (ticks, side²)."""
        what = touch.load()
        if self.side == SIDE:
            return what.felt_n
        fine = (what.felt_n if what.is_recorded else what.true_n).reshape(-1, SIDE, SIDE)
        coarse = averaged(fine, self.side).reshape(len(fine), -1)
        return coarse if what.is_recorded else touch.sensed(coarse, np.random.default_rng(touch.seed + 1))

    def _received(self, run: ScanRun, touch: Touch) -> Images | Updates:
        updates = run.received(touch)
        if self.receiver == "plain" and self.side == SIDE:
            return updates
        held = updates.held(run.scan_ns, self.side**2)
        if self.receiver == "plain":
            return refined(held, _PLAIN_ORDER)
        return refined(smoothed(held, SCAN_PENALTY_N if self.side == SIDE else CELLS_PENALTY_N), _SOLVED_ORDER)


@dataclass(frozen=True)
class FilteredEvents:
    """Event-triggered taxels behind the filter of adaptive sums, with its total variation: the strongest rival.

    `threshold_n`: by how much a filtered taxel must differ from what was sent last, newtons.
    """

    threshold_n: float

    @property
    def name(self) -> str:
        """What it is called in a table."""
        return f"filtered events, {1e3 * self.threshold_n:g} mN"

    def show(self, touch: Touch) -> Shown:
        """Send the changes of `touch`, with whatever bits they take."""
        counts, noise_n = _filtered(touch)
        run = run_events(counts, NEWTON_PER_COUNT, self.threshold_n)
        held = run.received(touch).held(np.arange(len(counts), dtype=np.int64) * TICK_NS, TAXELS)
        return Shown(run.sent, run.latency_ns, less_variation(held, noise_n), None)


#: The filter is the same for all thresholds.
_filtered = lru_cache(maxsize=1)(filtered_counts)

#: A way to acquire a touch: what it is called, and what it shows.
Scheme = Adaptive | Sums | Scan | FilteredEvents


@cache
def default_kbit_per_s() -> float:
    """Return the kbit/s of the default skin, all buses together, under the paper's golf ball."""
    return float(Sums().show(Touch("golf-ball")).sent.traffic()["kbit_per_s"])


def measure_scheme(scheme: Scheme, touch: Touch) -> Row:
    """Return the figures of one scheme on one touch, see `Shown.figures`."""
    return scheme.show(touch).figures(touch.load())
