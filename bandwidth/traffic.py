"""All frames of one bus as streams by falling priority, the input of loads and response times."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt
from cyclopts import Parameter

from bandwidth.response import blocking_ns, response_times_ns
from dbc.canopen import (
    HEARTBEAT_BASE,
    SDO_REQUEST_BASE,
    SDO_RESPONSE_BASE,
    SYNC_COB_ID,
    TIME_COB_ID,
    NmtState,
)
from dbc.contract import Contract
from dbc.dictionary import HEARTBEAT_MS
from dbc.frame import BRS, CLASSIC_BYTES, EXTENDED, FD, Frames, frames
from dbc.frame_bits import frame_time_ns, nominal_ns
from dbc.patch_filter import SAMPLE_NS
from dbc.time_of_day import time_frame
from skin.foreign import ForeignMessage
from skin.layout import Bus, Layout
from skin.ranges import require_number

#: Upper limit of both rates: more than the frames per second of a classic bus.
PER_SECOND_MAX: Final = 20_000.0
#: Longest time from a sample of a stepped board until the board has queued its frame.
STEPPED_JITTER_S: Final = 100e-6
#: Any instant, for the TIME of a plan: stuff bits of its data hardly differ from day to day.
_ANY_NS: Final = 1_750_000_000 * 10**9
#: Upper limit of the jitter: a later answer is no answer to this SYNC.
JITTER_MAX_S: Final = 1.0


@Parameter(name="*")
@dataclass(frozen=True)
class Disturbance:
    """Disturbances that response times include; InputError refuses numbers below 0 or impossibly large.

    Parameters
    ----------
    jitter_s : float
        Response times: time from SYNC until the slowest node has queued its TPDOs, seconds. Default: `device.jitter_s`
        of the layout; of stepped boards 0.0001, from the sample.
    sdo_per_s : float
        Response times: SDO transfers per second, each a request and a response of 8 bytes.
    errors_per_s : float
        Response times: frames per second that are disturbed and sent again.
    """

    jitter_s: float | None = None
    sdo_per_s: float = 20.0
    errors_per_s: float = 0.0

    def __post_init__(self) -> None:
        require_number("--jitter-s", self.jitter_s or 0.0, JITTER_MAX_S)
        require_number("--sdo-per-s", self.sdo_per_s, PER_SECOND_MAX)
        require_number("--errors-per-s", self.errors_per_s, PER_SECOND_MAX)

    def of(self, layout: Layout) -> "Disturbance":
        """Return these disturbances with the jitter that the boards of `layout` have by default, where none is set."""
        if self.jitter_s is not None:
            return self
        return replace(self, jitter_s=layout.device.jitter_s if layout.sends.in_cycles else STEPPED_JITTER_S)


@dataclass(frozen=True, eq=False)
class Traffic:
    """The frames of one bus in cycles of one turn, or in slots.

    Attributes
    ----------
    frames : array of FRAME, shape (n,)
        One frame of each stream, by priority: SYNC, TIME if the layout has it, TPDOs, SDO, heartbeats, and the
        messages of other devices that have a period.
    period_s, jitter_s : array of float, shape (n,)
    node : array of int, shape (n,)
        Sender's node-ID; 0 is the gateway.
    is_cyclic, is_tpdo, is_heartbeat, is_sdo_response : array of bool, shape (n,)
        Cyclic are SYNC and the TPDOs; of stepped boards, whose cycles are their slots, the TPDOs.
    foreign : tuple of ForeignMessage or None, length n
        The messages of other devices; None for streams of the skin.
    """

    bus: Bus
    frames: Frames
    period_s: npt.NDArray[np.float64]
    jitter_s: npt.NDArray[np.float64]
    node: npt.NDArray[np.intp]
    is_cyclic: npt.NDArray[np.bool_]
    is_tpdo: npt.NDArray[np.bool_]
    foreign: tuple[ForeignMessage | None, ...]

    @property
    def is_foreign(self) -> npt.NDArray[np.bool_]:
        """Which streams are those of other devices."""
        return np.array([each is not None for each in self.foreign], np.bool_)

    @property
    def is_extended(self) -> npt.NDArray[np.bool_]:
        """Which streams have identifiers of 29 bits."""
        found: npt.NDArray[np.bool_] = self.frames["flags"] & EXTENDED != 0
        return found

    @property
    def is_heartbeat(self) -> npt.NDArray[np.bool_]:
        """Which streams are heartbeats."""
        found: npt.NDArray[np.bool_] = (self.frames["can_id"] >= HEARTBEAT_BASE) & ~self.is_foreign
        return found

    @property
    def has_own_period(self) -> npt.NDArray[np.bool_]:
        """Which streams come at a rate of their own, whatever that of cycles: heartbeats, TIME, other devices."""
        is_ours: npt.NDArray[np.bool_] = (self.frames["can_id"] == TIME_COB_ID) | (self.frames["can_id"] == SYNC_COB_ID)
        return self.is_heartbeat | (is_ours & ~self.is_cyclic) | self.is_foreign

    @property
    def is_sdo_response(self) -> npt.NDArray[np.bool_]:
        """Which stream is the response of an SDO server."""
        can_id = self.frames["can_id"]
        return (can_id >= SDO_RESPONSE_BASE) & (can_id < SDO_REQUEST_BASE) & ~self.is_cyclic & ~self.is_foreign

    @property
    def worst_ns(self) -> npt.NDArray[np.int64]:
        """Longest time of each frame, intermission included."""
        return frame_time_ns(self.frames, self.bus.bitrate, self.bus.data_bitrate, "worst")

    def responses_ns(
        self, errors_per_s: float = 0.0, time_ns: npt.NDArray[np.int64] | None = None
    ) -> npt.NDArray[np.int64]:
        """Return an upper bound of the response time of each stream, see `response_times_ns`.

        One TPDO of the cycle before, begun at the end of its window, may block TPDOs, whatever its priority. `time_ns`
        are other times of the frames than `worst_ns`.
        """
        worst = self.worst_ns if time_ns is None else time_ns
        blocked = blocking_ns(worst)
        blocked[self.is_tpdo] = np.maximum(blocked, worst[self.is_tpdo].max(initial=0))[self.is_tpdo]
        return response_times_ns(
            worst,
            np.rint(self.period_s * 1e9).astype(np.int64),
            np.rint(self.jitter_s * 1e9).astype(np.int64),
            bit_ns=nominal_ns(1, self.bus.bitrate),
            blocked_ns=blocked,
            error_interval_ns=round(1e9 / errors_per_s) if errors_per_s else 0,
        )


def traffic(contract: Contract, bus: int, turn: int = 0, allowed: Disturbance | None = None) -> Traffic:
    """Return the streams of bus number `bus` in cycles of `turn`; SDO transfers are with the highest node-ID."""
    allowed = (allowed or Disturbance()).of(contract.layout)
    nodes = contract.on_bus(bus)
    cycle = contract.cycle(bus, turn)
    owner = {tpdo.cob_id: node.node_id for node in nodes for tpdo in node.tpdos}
    beats = frames(len(nodes))
    beats["can_id"] = [HEARTBEAT_BASE + node.node_id for node in nodes]
    beats["length"], beats["data"][:, 0] = 1, NmtState.OPERATIONAL
    last = nodes[-1].node_id
    transfers = frames(2 if allowed.sdo_per_s else 0)
    transfers["can_id"] = [SDO_RESPONSE_BASE + last, SDO_REQUEST_BASE + last][: len(transfers)]
    transfers["length"] = CLASSIC_BYTES
    time_s = contract.layout.sync.time_s
    times = time_frame(_ANY_NS)[: int(time_s is not None)]
    streams = np.concatenate([cycle, transfers, beats, times])
    sizes = len(cycle), len(transfers), len(beats), len(times)
    line = contract.layout.bus[bus]
    others = [each for each in line.foreign if each.period_s is not None]
    sdo_s = 1 / allowed.sdo_per_s if allowed.sdo_per_s else 1.0
    periods = contract.layout.sync.period_s, sdo_s, HEARTBEAT_MS * 1e-3, time_s or 1.0
    period_s, cyclic = np.repeat(periods, sizes), np.repeat([True, False, False, False], sizes)
    senders = [owner.get(int(can_id), 0) for can_id in cycle["can_id"]]
    node = np.array(
        [*senders, *[last, 0][: len(transfers)], *(each.node_id for each in nodes), *[0][: len(times)]], np.intp
    )
    is_tpdo, jitter_s = cyclic & (node > 0), allowed.jitter_s or 0.0
    if contract.in_steps:
        # A board looks for its slot when it has taken a sample.
        cyclic, jitter_s = is_tpdo, jitter_s + SAMPLE_NS * 1e-9
        period_s[is_tpdo] = contract.layout.steps.slot_s
    known = [None] * len(streams) + others
    streams = np.concatenate([streams, _foreign_frames(others, line)])
    ranks = [float(each["can_id"]) if whose is None else whose.rank for each, whose in zip(streams, known, strict=True)]
    order = np.argsort(ranks, kind="stable")
    more = np.zeros(len(others), np.intp)
    return Traffic(
        bus=line,
        frames=streams[order],
        period_s=np.concatenate([period_s, [each.period_s for each in others]])[order],
        jitter_s=np.concatenate([np.where(is_tpdo, jitter_s, 0.0), more])[order],
        node=np.concatenate([node, more])[order],
        is_cyclic=np.concatenate([cyclic, more > 0])[order],
        is_tpdo=np.concatenate([is_tpdo, more > 0])[order],
        foreign=tuple(known[place] for place in order),
    )


def _foreign_frames(messages: Sequence[ForeignMessage], line: Bus) -> Frames:
    """Return a frame of each message, with any data."""
    found = frames(len(messages))
    found["can_id"] = [each.identifier for each in messages]
    found["length"] = [each.length for each in messages]
    fast = FD | (BRS if line.data_bitrate else 0)
    found["flags"] = [(EXTENDED if each.is_extended else 0) | (fast if each.fd else 0) for each in messages]
    found["data"] = np.random.default_rng(0).integers(0, 256, found["data"].shape)
    found["data"][np.arange(found["data"].shape[1]) >= found["length"][:, None]] = 0
    return found
