"""Full acquisition: every value of an array is sent in turn, as often as the buses allow; and images of that."""

from dataclasses import replace
from functools import cache
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.ndimage import zoom

from dbc.canopen import TPDO_BASES
from dbc.codec import packed_values
from dbc.frame import Frames, frames
from evaluation.schemes.judge import Images, ValueRun
from evaluation.schemes.scenes import SIDE
from evaluation.schemes.wire import BUSES, TICK_NS, Nanoseconds, carry, lines_of, patches, syncs
from reconstructor.engine import AVERAGED_SAMPLES, Reconstructor
from reconstructor.kernels.graph import graph_of
from reconstructor.settings import LIVE
from reconstructor.walsh import VariationFilter
from skin.phi import Sbhe, sbhe
from skin.taxel import FORCE_MAX_N
from touch.contact import Force

FRAME_BITS: Final = 64


def run_scan(felt_n: Force, bits: int, rate_hz: float) -> ValueRun:
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
    sent["time_ns"] = sync_ns[:, None, None, :]
    calls, buses = syncs(sync_ns.ravel(), BUSES)
    of_bus = np.broadcast_to(np.arange(BUSES)[:, None, None], sent.shape)
    asked = np.concatenate([sent.ravel(), calls])
    wire = carry(asked, np.concatenate([of_bus.ravel(), buses]), lines_of(side), len(felt_n))
    frame_of = np.arange(sent.size).reshape(sent.shape)[..., last]
    ready = wire.ended_ns[frame_of]
    force = (raw * (FORCE_MAX_N / top)).astype(np.float32)
    latency = ready - sync_ns[:, None, None, first]
    return ValueRun(wire, ready.ravel(), np.broadcast_to(held, raw.shape).ravel(), force.ravel(), latency.ravel())


def _frames(raw: npt.NDArray[np.int64], bits: int, turns: int) -> Frames:
    """Return the frames of values of shape (scans, buses, nodes, values), shape (scans, buses, nodes, turns)."""
    scans, buses, nodes, values = raw.shape
    sent = frames(scans * buses * nodes * turns).reshape(scans, buses, nodes, turns)
    payloads = packed_values(raw.reshape(-1, values), bits)
    padded = np.pad(payloads, ((0, 0), (0, turns * 8 - payloads.shape[1])))
    sent["data"][..., :8] = padded.reshape(*sent.shape, 8)
    sent["length"] = np.minimum(8, -(-(values * bits - FRAME_BITS * np.arange(turns)) // 8))
    sent["can_id"] = np.array(TPDO_BASES[:turns]) + np.arange(1, nodes + 1)[:, None]
    return sent


def _sync_times(ticks: int, rate_hz: float, turns: int) -> Nanoseconds:
    """Return when each frame of each scan is asked for, ns, shape (scans, turns); only whole scans."""
    step_ns = 1e9 / (rate_hz * turns)
    scans = int(ticks * TICK_NS / (step_ns * turns) + 1e-9)
    times: Nanoseconds = np.rint(np.arange(scans * turns) * step_ns).astype(np.int64)
    return times.reshape(scans, turns)


@cache
def _complete(cells: int) -> Sbhe:
    """Return a Φ that keeps every row of every block: an orthogonal transform, no compression."""
    return sbhe(cells, cells)


def solved(held: Images, penalty_n: float) -> Images:
    """Return what the live reconstruction makes of images, as if every sum of every block had come.

    The array is a square of 8 x 8 cells or more.
    """
    cells = held.force_n.shape[1]
    side, phi = round(cells**0.5), _complete(cells)
    engine = Reconstructor(phi, side, side, replace(LIVE, penalty_n=penalty_n), samples=AVERAGED_SAMPLES)
    valid = np.ones(cells, np.bool_)
    sums = np.asarray(phi.forward(held.force_n), np.float32)
    images = np.stack([engine.solve(each, valid).ravel() for each in sums])
    return Images(held.ready_ns, images)


def smoothed(held: Images, limit_n: float) -> Images:
    """Return images of a square as the receiver of steps smooths them: neighbours differ by less, or not."""
    side = round(held.force_n.shape[1] ** 0.5)
    smooth = VariationFilter(graph_of(side, side, np.zeros(0, np.intp), None))
    images: list[Force] = [smooth(each.reshape(side, side), limit_n).ravel() for each in held.force_n]
    return Images(held.ready_ns, np.stack(images))


def refined(held: Images) -> Images:
    """Return a coarse array's images as fine as the skin, not below 0: bicubic splines."""
    side = round(held.force_n.shape[1] ** 0.5)
    if side == SIDE:
        return held
    spread = _spread(side)
    fine: Force = np.maximum(spread @ held.force_n.reshape(-1, side, side) @ spread.T, 0)
    return Images(held.ready_ns, fine.reshape(len(fine), -1))


@cache
def _spread(side: int) -> npt.NDArray[np.float32]:
    """Return the matrix that interpolates `side` cells at `SIDE` places, cell by cell from the edge."""
    columns = [zoom(each, SIDE / side, order=3, mode="nearest", grid_mode=True) for each in np.eye(side)]
    return np.stack(columns, axis=1).astype(np.float32)
