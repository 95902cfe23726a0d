"""Adaptive sums: nodes filter their own patch and send its sums when these are news."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from dbc.adaptive import BLOCK_SUMS, Companding, SendingRule, companding
from dbc.adaptive_filter import SETTLING_SAMPLES
from dbc.frame import FRAME, Frames, frame_bytes, frames
from evaluation.schemes.adaptive_bus import ASKED, ENDED, REASON, Record, line_of, run_bus
from evaluation.schemes.events import FRAMES_PER_TICK
from evaluation.schemes.judge import Images
from evaluation.schemes.patches import lines_of, patches
from evaluation.schemes.scenes import IDLE_TICKS_SHORT, NEWTON_PER_COUNT, SIDE, TAXELS, Touch
from evaluation.schemes.sums import SOLVED_NS
from evaluation.schemes.wire import TICK_NS, Asked, Nanoseconds, Sent, first_beats_ns
from gateway.adaptive_state import BusSums, new_sums, take
from nodes.adaptive.filtering import ForceFilter, PatchFilter
from nodes.adaptive.noise import IdleStatistics, Noise
from nodes.adaptive.sending import NEWS, new_groups, noise_threshold_n2
from reconstructor.walsh import LIMIT_RATIO, VariationFilter, WalshReconstructor
from skin.compiled import njit
from skin.layout import Bus
from skin.sending import COARSE_STEP_RATIO
from skin.taxel import FORCE_MAX_N
from touch.contact import Force

_RULE: Final = SendingRule()
_FIRST_BYTE: Final = FRAME.fields["can_id"][1]  # type: ignore[index]  # FRAME has fields

Counts = npt.NDArray[np.int16]
Cells = npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class AdaptiveRun:
    """What the nodes of a skin sent.

    Attributes
    ----------
    sent : Sent
        Bus by bus.
    latency_ns : array of int64
        Of news: from the sample that was first news to the end of the frame; of news that was not sent by the end, to
        the end.
    noise_n : float
        Median over the nodes of what they know of their noise.
    """

    sent: Sent
    latency_ns: Nanoseconds
    noise_n: float

    def images(self, arrives: npt.NDArray[np.bool_]) -> Images:
        """Return an image a millisecond of the frames that arrive; a lost frame stays unknown to the receiver."""
        ticks, law, shares = self.sent.ticks, companding(FORCE_MAX_N, COARSE_STEP_RATIO * FORCE_MAX_N), []
        for number, line in enumerate(self.sent.lines):
            mine = np.flatnonzero((self.sent.asked.bus == number) & arrives)
            sums_n = np.empty((ticks, line.nodes, BLOCK_SUMS), np.float32)
            rows = _bytes_of(self.sent.asked.frames[mine])
            _receive(rows, self.sent.arrived_ns[mine], law, new_sums(line.nodes), line.fd, sums_n)
            shares.append(sums_n)
        solver = WalshReconstructor(list(patches(SIDE)), SIDE, SIDE, self.noise_n)
        solved = [solver.solve(np.concatenate([each[tick] for each in shares])).ravel() for tick in range(ticks)]
        return Images(np.arange(ticks, dtype=np.int64) * TICK_NS + SOLVED_NS, np.stack(solved))


def learned_noise(idle: Counts, cells: Cells) -> Noise:
    """Return what nodes learn of an idle skin.

    Parameters
    ----------
    idle : array of int16, shape (ticks, taxels)
        What every taxel reads while nothing touches.
    cells : array of int, shape (nodes, taxels of a node)
    """
    statistics = IdleStatistics(*cells.shape)
    for sample in idle:
        statistics.take(_newtons(sample[cells]))
    return statistics.noise()


def run_adaptive(
    counts: Counts, idle: Counts, noise: Noise | None = None, lines: Sequence[Bus] | None = None
) -> AdaptiveRun:
    """Run the skin of 64 x 64 taxels on its buses.

    Parameters
    ----------
    counts, idle : arrays of int16, shape (ticks, 4096)
        What every taxel reads each millisecond, and what it read before, while nothing touched.
    noise : Noise, optional
        What the nodes believe of their noise, in place of what they learn from `idle`.
    lines : sequence of Bus, optional
        Other buses than classic ones of 1 Mbit/s: as many, with as many nodes.
    """
    lines = lines or lines_of(SIDE)
    held = patches(SIDE)
    cells = held.reshape(-1, held.shape[2])
    known = noise or learned_noise(idle, cells)
    node_filter = PatchFilter(known)
    _settle(node_filter, idle, cells)
    sums_n, variance_n2 = np.empty((2, len(counts), *cells.shape), np.float32)
    node_n = np.empty((len(counts), len(cells)))
    for tick, sample in enumerate(counts):
        node_filter.take(_newtons(sample[cells]))
        sums_n[tick], variance_n2[tick] = node_filter.sums_n, node_filter.variance_n2
        node_n[tick] = node_filter.noise.node_n
    parts = []
    for number in range(len(held)):
        mine = slice(number * held.shape[1], (number + 1) * held.shape[1])
        threshold_n2 = noise_threshold_n2(node_n[:, mine], _RULE.noise_ratio)
        parts.append(_run_bus(lines[number], sums_n[:, mine], variance_n2[:, mine], threshold_n2))
    bus = np.repeat(np.arange(len(held)), [len(part[0]) for part in parts])
    sent, log, unsent = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    wire = Sent(Asked(sent, bus, log[:, ASKED]), log[:, ENDED], lines, len(counts))
    latency = (wire.arrived_ns - log[:, ASKED])[log[:, REASON] == NEWS]
    waiting = (len(counts) - unsent) * TICK_NS
    return AdaptiveRun(wire, np.concatenate([latency, waiting]), float(np.median(node_n)))


def idle_of(touch: Touch) -> Counts:
    """Return what nodes learn from; a recording's own noise is not known, so its nodes learn from zeros."""
    idle = touch.idle()
    return np.zeros((IDLE_TICKS_SHORT, TAXELS), np.int16) if idle is None else idle


def filtered_counts(touch: Touch) -> tuple[Counts, float]:
    """Return what the nodes' filter makes of single taxels, and the median noise of a taxel, newtons.

    The filter and what it learns are those of adaptive sums, with every taxel a patch of its own.
    """
    counts, idle = touch.load().counts, idle_of(touch)
    cells = np.arange(counts.shape[1])[:, None]
    noise = learned_noise(idle, cells)
    taxel_filter = ForceFilter(noise)
    _settle(taxel_filter, idle, cells)
    filtered = np.empty_like(counts)
    for tick, sample in enumerate(counts):
        taxel_filter.take(_newtons(sample[cells]))
        shown = np.clip(taxel_filter.force_n[:, 0], 0, np.float32(FORCE_MAX_N))
        filtered[tick] = np.rint(shown / np.float32(NEWTON_PER_COUNT))
    return filtered, float(np.median(noise.node_n))


def less_variation(held: Images, noise_n: float) -> Images:
    """Return images as the receiver of adaptive sums would smooth them, 3 ms later."""
    smooth = VariationFilter(SIDE, SIDE)
    limit_n = LIMIT_RATIO * noise_n
    images: list[Force] = [smooth(each.reshape(SIDE, SIDE), limit_n).ravel() for each in held.force_n]
    return Images(held.ready_ns + SOLVED_NS, np.stack(images))


def _settle(node_filter: ForceFilter, idle: Counts, cells: Cells) -> None:
    for sample in idle[-SETTLING_SAMPLES:]:
        node_filter.take(_newtons(sample[cells]))


def _newtons(counts: npt.NDArray[np.integer]) -> Force:
    return counts.astype(np.float32) * np.float32(NEWTON_PER_COUNT)


def _run_bus(
    line: Bus, sums_n: Force, variance_n2: Force, threshold_n2: npt.NDArray[np.float64]
) -> tuple[Frames, npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return frames, log, and since when groups had news that was never sent."""
    ticks, nodes = sums_n.shape[:2]
    capacity = ticks * FRAMES_PER_TICK
    sent = frames(capacity)
    rows = frame_bytes(sent)[:, _FIRST_BYTE:]
    record, groups = Record(rows, np.empty((capacity, 7), np.int64)), new_groups(nodes, line.fd)
    law, beats = companding(FORCE_MAX_N, COARSE_STEP_RATIO * FORCE_MAX_N), first_beats_ns(nodes).copy()
    contiguous = np.ascontiguousarray(sums_n), np.ascontiguousarray(variance_n2)
    count = int(run_bus(*contiguous, threshold_n2, _RULE, law, groups, beats, line_of(line), record))
    return sent[:count].copy(), record.log[:count], groups.since[groups.since >= 0]


def _bytes_of(sent: Frames) -> npt.NDArray[np.uint8]:
    """Return FRAME records from `can_id` on."""
    return np.ascontiguousarray(frame_bytes(sent)[:, _FIRST_BYTE:])


@njit(cache=True, nogil=True)
def _receive(  # noqa: PLR0917  compiled functions take no keywords
    rows: npt.NDArray[np.uint8], arrived_ns: Nanoseconds, law: Companding, sums: BusSums, is_fd: bool, sums_n: Force
) -> None:
    """Write what the receiver of one bus knows at each millisecond, shape (ticks, nodes, BLOCK_SUMS)."""
    done = 0
    for tick in range(sums_n.shape[0]):
        while done < arrived_ns.size and arrived_ns[done] <= tick * TICK_NS:
            row = rows[done]
            take(int(row[0]) | int(row[1]) << 8, int(row[4]), row[8:], arrived_ns[done], law, sums, is_fd)
            done += 1
        sums_n[tick] = sums.value_n
