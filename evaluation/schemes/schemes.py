"""The schemes: what each sends of a touch, how late, and what its receiver shows."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import ClassVar, Final

import numpy as np

from dbc.contract import Contract
from evaluation.result import Row
from evaluation.schemes.board import Board, FilterName, board_of
from evaluation.schemes.events import run_events
from evaluation.schemes.judge import Images, quality
from evaluation.schemes.scan import refined, run_scan, smoothed, solved
from evaluation.schemes.scenes import NEWTON_PER_COUNT, SIDE, Scene, Touch
from evaluation.schemes.steps import run_stepped
from evaluation.schemes.sums import run_sums
from evaluation.schemes.wire import Nanoseconds, Sent
from reconstructor.walsh import LIMIT_RATIO
from skin.layout import load_layout

#: Bits of a value of a scan of raw samples: the converter's.
SCAN_BITS: Final = 10
#: Nothing is sampled more often than the recorded touches are.
SCAN_RATE_MAX_HZ: Final = 500.0
#: A scan is tried at this rate, to learn what one of this touch takes.
TRIAL_HZ: Final = 20.0
#: The bits of steps: what they take under the five slides, in the mean, with the paper's meshes.
STEPPED_KBIT_PER_S: Final = 414.0

#: Receivers: of our schemes, and of values that are shown as they came.
OURS: Final = "ours"
PLAIN: Final = "plain"


@dataclass(frozen=True, eq=False)
class Shown:
    """What a scheme sent of a touch, and what its receiver had in use.

    Attributes
    ----------
    sent : Sent
        All frames.
    latency_ns : array of int64, shape (values,)
        From the sample to the end of the frame that brings it.
    images : dict
        What is in use, by the name of the receiver: the best counts.
    rate_hz : float, optional
        How often all is sent; None for what goes by events.
    """

    sent: Sent
    latency_ns: Nanoseconds
    images: Mapping[str, Images]
    rate_hz: float | None

    def figures(self, what: Scene) -> Row:
        """Return bits, latency in ms, and `evaluation.schemes.judge.quality` against the touch's truth.

        Of several receivers ``receiver`` is the one with the best mean PSNR.
        """
        late_ns = float(np.percentile(self.latency_ns, 99)) if len(self.latency_ns) else 0.0
        found = {name: quality(what.true_n, each) for name, each in self.images.items()}
        receiver, best = max(found.items(), key=lambda each: float(each[1]["psnr_mean_db"]))
        about = {"receiver": receiver, "rate_hz": self.rate_hz, "latency_p99_ms": late_ns * 1e-6}
        return {"kbit_per_s": self.sent.kbit_per_s} | about | best


@dataclass(frozen=True)
class Stepped:
    """Steps: one setting for every touch; noise is learned from the idle skin."""

    #: What it is called in a table.
    name: ClassVar[str] = "steps"

    def show(self, board: Board) -> Shown:
        """Send what is worth its bits of `board`."""
        run = run_stepped(board, Contract.from_layout(load_layout(Path("steps"))))
        return Shown(run.sent, run.latency_ns, {OURS: run.images}, None)


@dataclass(frozen=True)
class Sums:
    """Sums in cycles: those of the default skin."""

    #: What it is called in a table.
    name: ClassVar[str] = "sums"

    def show(self, board: Board) -> Shown:
        """Measure in every cycle."""
        contract = Contract.from_layout(load_layout())
        run = run_sums(contract, board.counts, board.idle)
        return Shown(run.sent, run.latency_ns, {OURS: run.images(contract)}, 1 / contract.layout.sync.round_s)


@dataclass(frozen=True)
class Scan:
    """An array whose values are sent in turn, as often as the bits allow; the settings are the best for such scans.

    Attributes
    ----------
    side : int
        Cells of a side: of the skin, or of a coarse array.
    filter : str
        What the boards make of their samples.
    horizon : float
        Samples that the filter of stepped boards looks ahead.
    bits : int
        Of a value.
    penalty_n : float
        λ of our solver for all values, newtons.
    limit_ratio : float
        Limit of our smoothing, in units of the noise of a cell.
    kbit_per_s : float, optional
        Of all buses; by default those of the default skin.
    """

    side: int = SIDE
    filter: FilterName = "patches"
    horizon: float = 12.0
    bits: int = 7
    penalty_n: float = 0.004
    limit_ratio: float = 0.1
    kbit_per_s: float | None = None

    @property
    def name(self) -> str:
        """What it is called in a table."""
        name = "scan" if self.side == SIDE else f"{self.side} x {self.side}"
        bits = "" if self.kbit_per_s is None else f", {self.kbit_per_s:g} kbit/s"
        return f"{name}, {BOARDS[self.filter]}{bits}"

    def show(self, board: Board) -> Shown:
        """Scan the array of `board`."""
        force_n, noise_n = board.filtered(self.filter, self.horizon)
        trial = run_scan(force_n, self.bits, TRIAL_HZ).sent.kbit_per_s
        rate_hz = min(SCAN_RATE_MAX_HZ, TRIAL_HZ * (self.kbit_per_s or default_kbit_per_s()) / trial)
        run = run_scan(force_n, self.bits, rate_hz)
        held = run.held(*force_n.shape)
        images = {
            PLAIN: held,
            "our solver": solved(held, self.penalty_n),
            "our smoothing": smoothed(held, self.limit_ratio * noise_n),
        }
        return Shown(run.sent, run.latency_ns, {name: refined(each) for name, each in images.items()}, rate_hz)


#: Boards of scans by their filter, in words.
BOARDS: Final[dict[FilterName, str]] = {
    "raw": "one raw sample",
    "averaged": "filter of the default's boards",
    "patches": "filter of stepped boards",
}
#: The best scan that can be built. All settings are those with the best mean PSNR over the slides, with the paper's
#: meshes: of a horizon of 4 to 20, 5 to 10 bits, λ of 1 to 32 mN, limits of 0.05 to 0.4. With 6 bits slides have 0.3 dB
#: more, but a slap 1.5 dB less.
BEST_SCAN: Final = Scan()
#: Of λ of 4 to 32 mN; the filter has no horizon.
AVERAGED_SCAN: Final = Scan(filter="averaged", penalty_n=0.016)
#: All bits of the converters; of λ of 30 to 240 mN, limits of 0.5 to 2.
RAW_SCAN: Final = Scan(filter="raw", bits=SCAN_BITS, penalty_n=0.18, limit_ratio=0.5)
#: Of a horizon of 4 to 60, 4 to 8 bits, under golf ball and granola box.
THIN_SCAN: Final = Scan(horizon=40.0, bits=4, kbit_per_s=STEPPED_KBIT_PER_S)
#: Of a horizon of 4 and 8, 7 to 10 bits, λ of 1 to 12 mN, limits of 0.05 to 0.5.
COARSE_ARRAY: Final = Scan(32, horizon=8.0, penalty_n=0.001, limit_ratio=0.05)


@dataclass(frozen=True)
class FilteredEvents:
    """Event-triggered taxels behind the filter of stepped boards, with their smoothing.

    `threshold_n`: by how much a filtered taxel must differ from what was sent last, newtons.
    """

    threshold_n: float

    @property
    def name(self) -> str:
        """What it is called in a table."""
        return f"filtered events, {1e3 * self.threshold_n:g} mN"

    def show(self, board: Board) -> Shown:
        """Send the changes of `board`, with whatever bits they take."""
        force_n, noise_n = board.filtered("patches")
        counts = np.rint(force_n / np.float32(NEWTON_PER_COUNT)).astype(np.int16)
        run = run_events(counts, NEWTON_PER_COUNT, self.threshold_n)
        held = run.held(*counts.shape)
        images = {"our smoothing": smoothed(held, LIMIT_RATIO * noise_n)}
        return Shown(run.sent, run.latency_ns, images, None)


#: A way to acquire a touch: what it is called, and what it shows.
Scheme = Stepped | Sums | Scan | FilteredEvents


@cache
def default_kbit_per_s() -> float:
    """Return the kbit/s of the default skin, all buses together, under the paper's golf ball."""
    return Sums().show(board_of(Touch("golf-ball"))).sent.kbit_per_s


def measure_scheme(scheme: Scheme, touch: Touch) -> Row:
    """Return the figures of one scheme on one touch, see `Shown.figures`; the scheme sees the touch's board alone."""
    side = scheme.side if isinstance(scheme, Scan) else SIDE
    return scheme.show(board_of(touch, side)).figures(touch.load())
