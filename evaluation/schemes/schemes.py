"""The schemes: what each sends of a touch, how late, and what its receiver shows."""

from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, Final, Literal

import numpy as np

from evaluation.result import Row
from evaluation.schemes.adaptive import filtered_counts, idle_of, less_variation, run_adaptive
from evaluation.schemes.default_skin import default_kbit_per_s, skin_of
from evaluation.schemes.events import run_events
from evaluation.schemes.judge import Images, Updates, quality
from evaluation.schemes.scan import ScanRun, run_scan
from evaluation.schemes.scenes import NEWTON_PER_COUNT, SIDE, TAXELS, Scene, Touch
from evaluation.schemes.smoothing import CELLS_PENALTY_N, EVENTS_PENALTY_N, SCAN_PENALTY_N, refined, smoothed
from evaluation.schemes.sums import run_sums
from evaluation.schemes.wire import TICK_NS, Nanoseconds, Sent
from skin.layout import load_layout
from touch.coarse_arrays import averaged
from touch.contact import Force

Family = Literal["adaptive", "sums", "scan", "coarse", "events", "filtered events"]
#: What a cell of a coarse array is: one with the noise of any taxel, or what the node makes of its taxels.
Cells = Literal["sensor", "mean"]
#: Nothing is sampled more often than the recorded touches are.
SCAN_RATE_MAX_HZ: Final = 500.0
#: A scan is tried at this rate, to learn what one of this touch takes.
TRIAL_HZ: Final = 20.0
#: Images are solved from events as often as from the default skin's sums.
EVENT_IMAGE_MS: Final = 10
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
    """Adaptive sums: one setting for every touch; noise is learned from the idle skin."""

    receiver: ClassVar[str] = "solved"
    family: ClassVar[Family] = "adaptive"
    name: ClassVar[str] = "adaptive sums"

    def show(self, touch: Touch, share: float = 1.0) -> Shown:
        """Send the news of `touch`, with whatever bits they take: `share` has no effect."""
        del share
        run = run_adaptive(touch.load().counts, idle_of(touch))
        return Shown(run.sent, run.latency_ns, run.images(touch.arrives(len(run.sent.asked))), None)


@dataclass(frozen=True)
class Sums:
    """Compressed sums of the default skin's Φ, solved.

    Sums are no image, so a receiver always solves them.
    """

    bits: Literal[8, 12, 16]
    receiver: Literal["solved"] = "solved"
    family: ClassVar[Family] = "sums"

    @property
    def name(self) -> str:
        """What it is called in a table."""
        return f"sums, {self.bits} bits"

    def show(self, touch: Touch, share: float) -> Shown:
        """Measure `touch` at the rate that takes `share` of the default skin's bits a second."""
        what, rate_hz = touch.load(), share * load_layout().sync.rate_hz
        if self.bits != load_layout().encoding.sum_bits:
            trial = run_sums(skin_of(self.bits, rate_hz), what.counts, idle_counts=touch.idle()).sent.traffic()[
                "kbit_per_s"
            ]
            rate_hz *= share * default_kbit_per_s() / trial
        contract = skin_of(self.bits, rate_hz)
        run = run_sums(contract, what.counts, touch.loss_ratio, touch.seed, touch.idle())
        return Shown(run.sent, run.latency_ns, run.images(contract), rate_hz)


@dataclass(frozen=True)
class Scan:
    """An array of `side` x `side` cells, every value sent in turn.

    `side` is that of the skin, or a coarse array's; `bits` are those of one value.
    """

    side: int
    bits: int
    receiver: Literal["plain", "solved"] = "plain"
    cells: Cells = "sensor"

    @property
    def family(self) -> Family:
        """``scan`` where every taxel is sent, else ``coarse``."""
        return "scan" if self.side == SIDE else "coarse"

    @property
    def name(self) -> str:
        """What it is called in a table."""
        name = f"scan, {self.bits} bits" if self.family == "scan" else f"{self.side} x {self.side}"
        means = f" means of {(SIDE // self.side) ** 2} taxels" if self.cells == "mean" else ""
        return name + means + ("" if self.receiver == "plain" else f", {self.receiver}")

    def show(self, touch: Touch, share: float) -> Shown:
        """Scan `touch` as often as `share` of the default skin's bits a second allow."""
        felt_n = self._felt_n(touch)
        trial = run_scan(felt_n, self.bits, TRIAL_HZ).sent.traffic()["kbit_per_s"]
        rate_hz = min(SCAN_RATE_MAX_HZ, TRIAL_HZ * share * default_kbit_per_s() / trial)
        run = run_scan(felt_n, self.bits, rate_hz)
        return Shown(run.sent, run.latency_ns, self._received(run, touch), rate_hz)

    def _felt_n(self, touch: Touch) -> Force:
        """Return what the cells feel, newtons, shape (ticks, side²)."""
        what = touch.load()
        if self.family == "scan":
            return what.felt_n
        averages = self.cells == "mean" or what.is_recorded
        fine = (what.felt_n if averages else what.true_n).reshape(-1, SIDE, SIDE)
        coarse = averaged(fine, self.side).reshape(len(fine), -1)
        return coarse if averages else touch.sensed(coarse, np.random.default_rng(touch.seed + 1))

    def _received(self, run: ScanRun, touch: Touch) -> Images | Updates:
        updates = run.received(touch)
        if self.receiver == "plain" and self.family == "scan":
            return updates
        held = updates.held(run.scan_ns, self.side**2)
        if self.receiver == "plain":
            return refined(held, _PLAIN_ORDER)
        penalty_n = SCAN_PENALTY_N if self.family == "scan" else CELLS_PENALTY_N
        return refined(smoothed(held, penalty_n), _SOLVED_ORDER)


@dataclass(frozen=True)
class Events:
    """Event-triggered taxels: sent when they have changed.

    Attributes
    ----------
    threshold_n : float
        By how much a taxel must differ from the value that was sent last, newtons.
    dead_ms : int
        How long a taxel is not sent after each sending, milliseconds.
    receiver : str
        No receiver filters noise: what an unsent change leaves is no noise of the sensor.
    """

    threshold_n: float
    dead_ms: int
    receiver: Literal["plain", "solved"] = "plain"
    family: ClassVar[Family] = "events"

    @property
    def name(self) -> str:
        """What it is called in a table."""
        rule = f"events, {1e3 * self.threshold_n:g} mN, {self.dead_ms} ms"
        return rule + ("" if self.receiver == "plain" else f", {self.receiver}")

    def show(self, touch: Touch, share: float = 1.0) -> Shown:
        """Send the changes of `touch`, with whatever bits they take: `share` has no effect."""
        del share
        what = touch.load()
        run = run_events(what.counts, NEWTON_PER_COUNT, self.threshold_n, self.dead_ms)
        latency_ns = np.concatenate([run.latency_ns, run.waiting_ns])
        return Shown(run.sent, latency_ns, self._received(run.received(touch), len(what.counts)), None)

    def _received(self, updates: Updates, ticks: int) -> Images | Updates:
        if self.receiver == "plain":
            return updates
        held = updates.held(np.arange(0, ticks, EVENT_IMAGE_MS, dtype=np.int64) * TICK_NS, TAXELS)
        return smoothed(held, EVENTS_PENALTY_N, temporal_filter=False)


@dataclass(frozen=True)
class FilteredEvents:
    """Event-triggered taxels, each behind the filter of adaptive sums: the strongest rival.

    Attributes
    ----------
    threshold_n : float
        By how much a filtered taxel must differ from what was sent last, newtons.
    receiver : str
        ``solved``: with the total variation of adaptive sums.
    """

    threshold_n: float
    receiver: Literal["plain", "solved"] = "plain"
    family: ClassVar[Family] = "filtered events"

    @property
    def name(self) -> str:
        """What it is called in a table."""
        rule = f"filtered events, {1e3 * self.threshold_n:g} mN"
        return rule + ("" if self.receiver == "plain" else f", {self.receiver}")

    def show(self, touch: Touch, share: float = 1.0) -> Shown:
        """Send the changes of `touch`, with whatever bits they take: `share` has no effect."""
        del share
        counts, noise_n = _filtered(touch)
        run = run_events(counts, NEWTON_PER_COUNT, self.threshold_n)
        updates = run.received(touch)
        latency_ns = np.concatenate([run.latency_ns, run.waiting_ns])
        if self.receiver == "plain":
            return Shown(run.sent, latency_ns, updates, None)
        held = updates.held(np.arange(len(counts), dtype=np.int64) * TICK_NS, TAXELS)
        return Shown(run.sent, latency_ns, less_variation(held, noise_n), None)


#: The filter is the same for all thresholds.
_filtered = lru_cache(maxsize=1)(filtered_counts)

#: A way to acquire a touch: what it is called, its family, what its receiver does, and what it shows.
Scheme = Adaptive | Sums | Scan | Events | FilteredEvents


def measure_scheme(scheme: Scheme, touch: Touch, share: float) -> Row:
    """Return the figures of one scheme on one touch, see `Shown.figures`; `share` of the default skin's bits."""
    return scheme.show(touch, share).figures(touch.load())
