"""Full acquisition: every value of an array is sent in turn, as often as the buses allow."""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from dbc.canopen import TPDO_BASES
from dbc.codec import encode
from dbc.frame import Frames, frames
from dbc.packing import Packing
from evaluation.schemes.judge import Updates, ValueRun
from evaluation.schemes.patches import lines_of, patches
from evaluation.schemes.wire import TICK_NS, Asked, Nanoseconds, carry, syncs
from skin.taxel import FORCE_MAX_N
from touch.contact import Force

FRAME_BITS: Final = 64


@dataclass(frozen=True, eq=False)
class ScanRun(ValueRun):
    """What a scanned array sent; `scan_ns`, shape (scans,): when the last value of each scan had arrived."""

    scan_ns: Nanoseconds


def run_scan(felt_n: Force, bits: int, rate_hz: float) -> ScanRun:
    """Scan an array `rate_hz` times a second.

    Frame k of every node is sent at the k-th of as many evenly spaced SYNCs as a node has frames, with values sampled
    at that SYNC and packed without a gap: no value is older than it must be. A value that two frames share is sampled
    for the first.

    Parameters
    ----------
    felt_n : array of float32, shape (ticks, cells)
        What the cells feel each millisecond, newtons.
    bits : int
        Of one value.
    rate_hz : float
    """
    side = round(felt_n.shape[1] ** 0.5)
    held = patches(side)
    values = held.shape[2]
    turns = -(-values * bits // FRAME_BITS)
    sync_ns = _sync_times(len(felt_n), rate_hz, turns)
    first, last = ((np.arange(values) * bits + bit) // FRAME_BITS for bit in (0, bits - 1))
    sampled = np.minimum(np.rint(sync_ns[:, first] / TICK_NS).astype(np.int64), len(felt_n) - 1)
    top = (1 << bits) - 1
    raw = np.rint(felt_n[sampled[:, None, None, :], held] * (top / FORCE_MAX_N)).astype(np.int64)
    sent = _frames(raw, bits, turns)
    asked = _asked(sent, sync_ns)
    wire = carry([asked, syncs(sync_ns.ravel(), lines_of(side))], lines_of(side), len(felt_n))
    frame_of = np.arange(sent.size).reshape(sent.shape)[..., last]
    ready = wire.arrived_ns[frame_of]
    force = (raw * (FORCE_MAX_N / top)).astype(np.float32)
    updates = Updates(ready.ravel(), np.broadcast_to(held, raw.shape).ravel(), force.ravel())
    latency = ready - sync_ns[:, None, None, first]
    scan_ns = ready.reshape(len(ready), -1).max(axis=1)
    return ScanRun(wire, updates, frame_of.ravel(), latency.ravel(), scan_ns)


def _frames(raw: npt.NDArray[np.int64], bits: int, turns: int) -> Frames:
    """Return the frames of values of shape (scans, buses, nodes, values), shape (scans, buses, nodes, turns)."""
    scans, buses, nodes, values = raw.shape
    sent = frames(scans * buses * nodes * turns).reshape(scans, buses, nodes, turns)
    payloads = encode(raw.ravel(), np.arange(raw.size).reshape(-1, values), Packing(bits, scale=1, offset=0))
    padded = np.pad(payloads, ((0, 0), (0, turns * 8 - payloads.shape[1])))
    sent["data"][..., :8] = padded.reshape(*sent.shape, 8)
    sent["length"] = np.minimum(8, -(-(values * bits - FRAME_BITS * np.arange(turns)) // 8))
    sent["can_id"] = np.array(TPDO_BASES[:turns]) + np.arange(1, nodes + 1)[:, None]
    return sent


def _asked(sent: Frames, sync_ns: Nanoseconds) -> Asked:
    bus = np.broadcast_to(np.arange(sent.shape[1])[:, None, None], sent.shape)
    times = np.broadcast_to(sync_ns[:, None, None, :], sent.shape)
    return Asked(sent.ravel(), bus.ravel(), times.ravel())


def _sync_times(ticks: int, rate_hz: float, turns: int) -> Nanoseconds:
    """Return when each frame of each scan is asked for, ns, shape (scans, turns); only whole scans."""
    step_ns = 1e9 / (rate_hz * turns)
    scans = int(ticks * TICK_NS / (step_ns * turns) + 1e-9)
    times: Nanoseconds = np.rint(np.arange(scans * turns) * step_ns).astype(np.int64)
    return times.reshape(scans, turns)
