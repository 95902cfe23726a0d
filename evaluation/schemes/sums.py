"""Our own: compressed sums of a layout that `skin plan` knows, and the images of the live reconstruction."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dbc.codec import encode
from dbc.contract import Contract
from dbc.frame import Frames, frames
from evaluation.schemes.judge import Images
from evaluation.schemes.wire import TICK_NS, Nanoseconds, Sent, carry, syncs
from nodes.averaging import SampleFilter
from reconstructor.engine import Reconstructor
from reconstructor.settings import LIVE
from skin.sync_counter import SYNC_OVERFLOW


@dataclass(frozen=True, eq=False)
class SumsRun:
    """What the nodes of a skin sent.

    Attributes
    ----------
    sent : Sent
        TPDOs first, cycle by cycle.
    sums_n : array of float32, shape (cycles, m)
        The newest of each sum, as the gateway decodes them, newtons.
    closed_ns : array of int64, shape (cycles,)
        When the gateway had all of a cycle.
    latency_ns : array of int64, shape (sums' frames,)
        From SYNC to the end of each frame.
    """

    sent: Sent
    sums_n: npt.NDArray[np.float32]
    closed_ns: Nanoseconds
    latency_ns: Nanoseconds

    def images(self, contract: Contract) -> Images:
        """Return the live reconstruction of every cycle; of the first only once the sums of all turns have come."""
        layout, taxels = contract.layout, contract.layout.taxels
        samples, turns = layout.samples_per_sync, layout.sync.turns
        engine = Reconstructor(contract.phi, taxels.rows, taxels.columns, LIVE, samples=samples, turns=turns)
        images = np.empty((len(self.sums_n), taxels.count), np.float32)
        for cycle, sums_n in enumerate(self.sums_n):
            images[cycle] = engine.solve(sums_n, np.full(sums_n.size, cycle >= turns - 1)).ravel()
        return Images(self.closed_ns, images)


def run_sums(
    contract: Contract,
    counts: npt.NDArray[np.int16],
    idle_counts: npt.NDArray[np.int16] | None = None,
) -> SumsRun:
    """Measure a recording with the nodes of a contract.

    Parameters
    ----------
    counts : array of int16, shape (ticks, n)
        What every taxel reads, each millisecond.
    idle_counts : array of int16, shape (ticks, n), optional
        What the taxels read before: nodes that average learn their noise from it.
    """
    period_ns = 1e9 / contract.layout.sync.rate_hz
    cycles = int(len(counts) * TICK_NS / period_ns + 1e-9)
    sync_ns = np.rint(np.arange(cycles) * period_ns).astype(np.int64)
    sampled = np.minimum(np.rint(sync_ns / TICK_NS).astype(np.int64), len(counts) - 1)
    sums = _sums(contract, counts, sampled, idle_counts)
    table, turns = contract.table, np.arange(cycles) % contract.turns
    rows = [np.flatnonzero(table.turn == turn) for turn in range(contract.turns)]
    due = np.stack([rows[turn] for turn in turns])
    bursts = [burst(contract, each, due[cycle], 1 + cycle % SYNC_OVERFLOW) for cycle, each in enumerate(sums)]
    calls, buses = syncs(sync_ns, len(contract.layout.bus))
    asked = np.concatenate([*bursts, calls])
    asked["time_ns"][: due.size] = np.repeat(sync_ns, due.shape[1])
    sent = carry(asked, np.concatenate([table.bus[due].ravel(), buses]), contract.layout.bus, len(counts))
    arrived = sent.ended_ns[: due.size].reshape(due.shape)
    received, newest = contract.packing.counts(contract.packing.raw(sums)), np.zeros(contract.phi.shape[0], np.int32)
    for turn, each in zip(turns, received, strict=True):
        newest[contract.sums_of_turn[turn]] = each[contract.sums_of_turn[turn]]
        each[:] = newest
    sums_n = (received * contract.layout.taxels.newton_per_count).astype(np.float32)
    return SumsRun(sent, sums_n, arrived.max(axis=1), (arrived - sync_ns[:, None]).ravel())


def _sums(
    contract: Contract,
    counts: npt.NDArray[np.int16],
    sampled: npt.NDArray[np.int64],
    idle_counts: npt.NDArray[np.int16] | None,
) -> npt.NDArray[np.int32]:
    """Return the sums at the ticks `sampled`, shape (cycles, m): of what is read then, or averaged as nodes average."""
    phi = contract.phi
    if contract.layout.samples_per_sync == 1:
        return np.asarray(phi.forward(counts[sampled]), np.int32)
    average = SampleFilter(phi.taxels_of_blocks)
    if idle_counts is not None:
        average.take(idle_counts.astype(np.float32))
    averages, begin = np.empty((len(sampled), counts.shape[1]), np.float32), 0
    for cycle, tick in enumerate(sampled.tolist()):
        average.take(counts[begin : tick + 1].astype(np.float32))
        averages[cycle], begin = average.counts, tick + 1
    sums: npt.NDArray[np.int32] = np.rint(np.asarray(phi.forward(averages), np.float32)).astype(np.int32)
    return sums


def burst(contract: Contract, sums: npt.NDArray[np.integer], rows: npt.NDArray[np.intp], sync_counter: int) -> Frames:
    """Return the TPDOs of the rows of the contract's table, with `sums`, shape (m,), of a cycle."""
    table = contract.table
    made = frames(len(rows))
    made["can_id"], made["length"], made["flags"] = table.cob_id[rows], table.length[rows], table.flags[rows]
    payloads = encode(sync_counter, sums, table.gather[rows], contract.packing)
    made["data"][:, : payloads.shape[1]] = payloads
    return made
