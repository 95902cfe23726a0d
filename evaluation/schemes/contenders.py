"""One contender on one touch: what it sent, how late, and how good the image in use was."""

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final, Literal

import msgspec
import numpy as np

from bandwidth.alternatives import with_buses
from dbc.contract import Contract, contract
from evaluation.findings import Row
from evaluation.schemes.events import EventRule, run_events
from evaluation.schemes.judge import Images, Updates, quality
from evaluation.schemes.scan import ScanRun, run_scan
from evaluation.schemes.scenes import NEWTON_PER_COUNT, Scene, scene
from evaluation.schemes.smoothing import CELLS_PENALTY_N, EVENTS_PENALTY_N, SCAN_PENALTY_N, refined, smoothed
from evaluation.schemes.sums import run_sums
from evaluation.schemes.wire import Nanoseconds, Sent
from skin.layout import load_layout
from touch.arrays import averaged
from touch.contact import Force
from touch.electronics import sense

#: What a receiver does: shows what came; or solves as our service does, without or with the sensor's noise known.
Receiver = Literal["plain", "solved", "noise known"]
#: Nothing is sampled more often than the recorded touches are.
SCAN_RATE_MAX_HZ: Final = 500.0
#: Bits a second of the default skin on four buses at 100 Hz, of all buses.
DEFAULT_KBIT_PER_S: Final = 3050.0


@dataclass(frozen=True)
class Touch:
    """A scene and what is wrong with it, see `evaluation.schemes.scenes.scene`.

    Attributes
    ----------
    name : str
    ticks : int, optional
        Only the first so many.
    noise_n : float
        Of the sensor.
    loss_ratio : float
        Part of all frames that never reach the receiver.
    meshes : str, optional
        Folder.
    seed : int
    """

    name: str
    ticks: int | None = None
    noise_n: float = 1e-3
    loss_ratio: float = 0.0
    meshes: str | None = None
    seed: int = 0

    @property
    def words(self) -> str:
        """What it is called in a table."""
        name = f"recording {Path(self.name).stem}" if self.name.endswith(".npz") else self.name
        noise = f", noise {1e3 * self.noise_n:g} mN" if self.noise_n != 1e-3 else ""
        return name + noise + (f", {self.loss_ratio:.0%} of frames lost" if self.loss_ratio else "")

    def load(self) -> Scene:
        """Return the touch itself."""
        meshes = Path(self.meshes) if self.meshes else None
        return scene(self.name, ticks=self.ticks, noise_n=self.noise_n, meshes=meshes, seed=self.seed)


def measure_sums(touch: dict[str, Any], *, bits: int, kbit_per_s: float, receiver: Receiver) -> Row:
    """Return the figures of compressed sums of `bits` each at a rate that makes `kbit_per_s`."""
    shown, what = Touch(**touch), Touch(**touch).load()
    rate_hz = 100.0 * kbit_per_s / DEFAULT_KBIT_PER_S
    if bits != 16:
        trial = run_sums(_skin(bits, rate_hz), what.counts)
        rate_hz *= kbit_per_s / trial.sent.traffic()["kbit_per_s"]
    made = _skin(bits, rate_hz)
    run = run_sums(made, what.counts, shown.loss_ratio, shown.seed)
    images = run.images(made, shown.noise_n if receiver == "noise known" else None)
    return measured_row(what, run.sent, run.latency_ns, images) | {"rate_hz": rate_hz}


def measure_scan(
    touch: dict[str, Any], *, side: int, bits: int, kbit_per_s: float, receiver: Receiver, cells: str
) -> Row:
    """Return the figures of an array of `side` x `side`, scanned as often as `kbit_per_s` allow.

    `cells` says what a cell of a coarse array is: ``sensor``, one with the noise of any taxel, or ``mean``, what the
    node makes of its taxels.
    """
    shown, what = Touch(**touch), Touch(**touch).load()
    felt_n = _cells(what, shown, side, cells)
    trial = run_scan(felt_n, bits, 20.0).sent.traffic()["kbit_per_s"]
    rate_hz = min(SCAN_RATE_MAX_HZ, 20.0 * kbit_per_s / trial)
    run = run_scan(felt_n, bits, rate_hz)
    updates = _left(run, shown)
    if receiver == "plain" and side == 64:
        return measured_row(what, run.sent, run.latency_ns, updates) | {"rate_hz": rate_hz}
    held = updates.held(run.scan_ns, side * side)
    if receiver != "plain":
        noise_n = shown.noise_n * (side / 64 if cells == "mean" else 1.0) if receiver == "noise known" else None
        held = smoothed(held, SCAN_PENALTY_N if side == 64 else CELLS_PENALTY_N, noise_n=noise_n)
    order = 1 if receiver == "plain" else 3
    return measured_row(what, run.sent, run.latency_ns, refined(held, order)) | {"rate_hz": rate_hz}


def measure_events(touch: dict[str, Any], *, threshold_n: float, dead_ms: int, receiver: Receiver) -> Row:
    """Return the figures of event-triggered taxels."""
    shown, what = Touch(**touch), Touch(**touch).load()
    run = run_events(what.counts, NEWTON_PER_COUNT, EventRule(threshold_n, dead_ms))
    random = np.random.default_rng(shown.seed)
    updates = run.without(random.random(len(run.sent.asked)) < shown.loss_ratio)
    latency = np.concatenate([run.latency_ns, run.waiting_ns])
    return measured_row(what, run.sent, latency, _received(updates, receiver, len(what.counts))) | {"rate_hz": None}


def _received(updates: Updates, receiver: Receiver, ticks: int) -> Images | Updates:
    if receiver == "plain":
        return updates
    held = updates.held(np.arange(0, ticks, 10, dtype=np.int64) * 1_000_000, 4096)
    return smoothed(held, EVENTS_PENALTY_N, remembering=False)


def _cells(what: Scene, shown: Touch, side: int, cells: str) -> Force:
    """Return what the cells of an array feel, shape (ticks, side²)."""
    if side == 64:
        return what.felt_n
    fine = (what.felt_n if cells == "mean" or what.is_recorded else what.true_n).reshape(-1, 64, 64)
    coarse = averaged(fine, side).reshape(len(fine), -1)
    if cells == "mean" or what.is_recorded:
        return coarse
    return sense(coarse, np.random.default_rng(shown.seed + 1), shown.noise_n)


def _left(run: ScanRun, shown: Touch) -> Updates:
    """Return the updates of the frames that were not lost."""
    if not shown.loss_ratio:
        return run.updates
    came = np.random.default_rng(shown.seed).random(len(run.sent.asked)) >= shown.loss_ratio
    left, every = came[run.frame_of], run.updates
    return Updates(every.ready_ns[left], every.taxel[left], every.force_n[left])


@cache
def _skin(bits: int, rate_hz: float) -> Contract:
    """Return the default skin, for 12 bits with two blocks per node, whose sums fill their frames."""
    layout = load_layout()
    if bits != 16:
        like = msgspec.structs.replace(layout.bus[0], blocks_per_node=2 if bits == 12 else 1)
        encoding = msgspec.structs.replace(layout.encoding, sum_bits=bits, offset_binary=True)
        layout = msgspec.structs.replace(with_buses(layout, len(layout.bus), like), encoding=encoding)
    return contract(msgspec.structs.replace(layout, sync=msgspec.structs.replace(layout.sync, rate_hz=rate_hz)))


def measured_row(what: Scene, sent: Sent, latency_ns: Nanoseconds, shown: Images | Updates) -> Row:
    """Return the figures of what was sent, how late it was, and what is shown of it."""
    late = {
        "latency_p99_ms": float(np.percentile(latency_ns, 99)) * 1e-6 if len(latency_ns) else 0.0,
        "latency_worst_ms": float(latency_ns.max()) * 1e-6 if len(latency_ns) else 0.0,
    }
    return sent.traffic() | late | quality(what.true_n, shown)
