"""The gateway's loop in recorded time: recorded frames in, measurements out. Nothing is sent, and no clock is read.

The loop does what it does live with frames, but for what frames do not tell. Which nodes are proven, their boot-up
messages and starts tell (`gateway.inferred_proofs`). Each SYNC as the layout has it counts as the
gateway's. A cycle ends when all frames of every node have come, or when it is out of time on the clock of the frames. A
live gateway reads its frames a little later than they end, so it ends a cycle with the same frames or with fewer: a
block that was valid live is valid here and has the same sums.
"""

from collections.abc import Collection, Iterator, Mapping
from typing import Final, NamedTuple

import msgspec
import numpy as np

from bus.link import State
from calibration.calibrator import Calibrator
from calibration.offline import calibrated
from canskin.errors import InputError
from canskin.messages import GatewayStatus, Measurement
from dbc.canopen import SYNC_COB_ID
from dbc.contract import Contract
from dbc.frame import ECHO, ERROR, EXTENDED, FD, REMOTE, Frames, frames
from gateway.cycle_gathering import GRACE
from gateway.gathering import Sync
from gateway.inferred_proofs import Change, InferredProofs
from gateway.loop import GatewayLoop
from gateway.sync_clock import mean_rate_hz
from skin.sync_counter import SYNC_OVERFLOW

#: A late SYNC of one bus may come after the next SYNC of another bus, but not later.
_CYCLES_IN_FLIGHT: Final = 2
#: Of this number of frames with sums at least one is used: the first byte of a frame without counter is that of an open
#: cycle by chance.
_NAMED: Final = 10
#: Stepped sums are measured for so long after the last frame; a clock that was set forward ends in no loop of years.
_SILENCE_NS: Final = 60_000_000_000
#: Length of the parts of a log.
_PART_NS: Final = 100_000_000


class Playback:
    """Makes the measurements of recorded frames.

    Parameters
    ----------
    buses : collection of int
        Numbers of the recorded buses. Blocks of other buses are not valid.
    start_ns : int
        No frame is earlier; on the clock of the frames.
    wall_offset_ns : int
        Wall clock minus the clock of the frames.
    calibrator : Calibrator, optional
        Puts offsets into the measurements.

    Attributes
    ----------
    cycles : int
        SYNCs so far.
    """

    def __init__(
        self,
        contract: Contract,
        buses: Collection[int],
        start_ns: int,
        wall_offset_ns: int = 0,
        *,
        calibrator: Calibrator | None = None,
    ) -> None:
        self.cycles = 0
        self._calibrator = calibrator
        self._wall_offset_ns = wall_offset_ns
        self._contract = contract
        # A microsecond later, for the rounding of times in seconds.
        self._grace_ns = round((1 + GRACE) * contract.layout.sync.period_s * 1e9) + 1_000
        self._near_ns = round(contract.layout.sync.period_s * 1e9 / 2)
        sends = dict.fromkeys(sorted(buses), len)  # all is accepted, nothing is sent
        self._loop = GatewayLoop(contract, sends, start_ns * 1e-9, say=lambda _: None, complain=lambda _: None)
        for node in contract.nodes:
            if node.bus in sends:
                self._loop.gathering.trust(node, proven=True)
        self._nodes = {(node.bus, node.node_id): node for node in contract.nodes}
        self._proofs = {number: InferredProofs([node.node_id for node in contract.on_bus(number)]) for number in sends}
        self._waiting: dict[int, list[Frames]] = {number: [] for number in sends}
        self._sampled_ns = int(np.iinfo(np.int64).min)
        self._fed_ns = dict.fromkeys(sends, start_ns)
        self._ready = {number: _Ready(frames(0)) for number in sends}
        #: The newest cycles: counter, time of the first SYNC, and the buses whose SYNC has come.
        self._open: list[tuple[int, int, set[int]]] = []
        self._now_ns = start_ns
        self._first_sync_ns: int | None = None
        self._sync_ns: int | None = None
        self._made: list[Measurement] = []

    def feed(self, bus: int, logged: Frames) -> None:
        """Take frames of a bus, in bus order; they are used by `advance`. Times that fall stand still."""
        marked = with_echoes(logged)
        if len(marked):
            newest_ns = np.maximum.accumulate(np.maximum(marked["time_ns"], self._fed_ns[bus]))
            marked["time_ns"] = np.where(newest_ns - marked["time_ns"] > self._near_ns, newest_ns, marked["time_ns"])
            self._fed_ns[bus] = int(newest_ns[-1])
        self._waiting[bus].append(marked)

    def advance(self, until_ns: int) -> list[Measurement]:
        """Use all frames up to a time, of which none is missing; return the measurements that were made.

        `Measurement.cycle` is the number of the SYNC, from 1; its times are those of the frames.
        """
        found: list[tuple[int, int, int, Change | None]] = []
        for number, waiting in self._waiting.items():
            seen = np.concatenate((frames(0), *waiting))
            newest_ns = np.maximum.accumulate(seen["time_ns"])
            count = int(np.searchsorted(newest_ns, until_ns, "right"))
            self._waiting[number] = [seen[count:]]
            ready = self._ready[number] = _Ready(seen[:count])
            changes = self._proofs[number].changes(ready.frames)
            told = [*((place, None) for place in ready.syncs), *((change.place, change) for change in changes)]
            found += [(int(newest_ns[place]), number, place, change) for place, change in told]
        for time_ns, number, place, change in sorted(found, key=lambda each: each[:3]):
            if change is None:
                self._take_sync(time_ns, number, place)
            else:
                self._go_to(time_ns, {number: place})
                self._loop.gathering.trust(self._nodes[number, change.node_id], proven=change.is_proven)
        self._go_to(until_ns, {number: len(ready.frames) for number, ready in self._ready.items()})
        return self._take_made()

    def finish(self) -> list[Measurement]:
        """Use the last frames; return the last measurements."""
        last_ns = [int(seen["time_ns"].max()) for waiting in self._waiting.values() for seen in waiting if len(seen)]
        made = self.advance(max(last_ns, default=self._now_ns))
        self._measure(self._now_ns + self._grace_ns)
        return made + self._take_made()

    def _take_made(self) -> list[Measurement]:
        forward = []
        for each in self._made:
            if each.sampled_mono_ns >= self._sampled_ns:  # else its SYNC was stamped by a clock that was set back
                self._sampled_ns = each.sampled_mono_ns
                forward.append(each)
        self._made = []
        return list(calibrated(forward, self._calibrator))

    def status(self) -> GatewayStatus:
        """Return the counters of the gateway; the states of nodes are those of their newest heartbeats."""
        status = self._loop.status(dict.fromkeys(self._ready, (State.ACTIVE, 0)), self._now_ns * 1e-9)
        elapsed_s = (self._now_ns - (self._first_sync_ns or self._now_ns)) * 1e-9
        rate_hz = mean_rate_hz(self.cycles, elapsed_s)
        return msgspec.structs.replace(status, time_ns=self._now_ns + self._wall_offset_ns, sync_rate_hz=rate_hz)

    def _take_sync(self, time_ns: int, number: int, place: int) -> None:
        """Begin the cycle of a SYNC, or take note that its SYNC has come on one more bus."""
        counter = int(self._ready[number].frames["data"][place, 0])
        for known, begun_ns, buses in self._open:
            # The same SYNC twice is no new cycle: the collector does not use its sums.
            if known == counter and (number not in buses or time_ns - begun_ns < self._near_ns):
                buses.add(number)
                return
        if self._sync_ns is not None and self._sync_ns + self._grace_ns < time_ns:
            self._go_to(self._sync_ns + self._grace_ns)
        self._go_to(time_ns, {number: place})
        self.cycles += 1
        self._sync_ns = time_ns
        if self._first_sync_ns is None:
            self._first_sync_ns = time_ns
        sync = Sync(self.cycles, counter, time_ns, None, self._wall_offset_ns)
        self._made += self._loop.gathering.begin(sync)
        self._open = [*self._open[1 - _CYCLES_IN_FLIGHT :], (counter, time_ns, {number})]

    def _go_to(self, time_ns: int, ends: Mapping[int, int] | None = None) -> None:
        """Use the frames before a time, of some buses those before a place, and make the measurements that are due."""
        step_ns = self._loop.gathering.replay_step_ns
        if step_ns is not None:
            for between_ns in range(self._now_ns + step_ns, min(time_ns, self._now_ns + _SILENCE_NS), step_ns):
                self._take_until(between_ns, {})
                self._measure(between_ns)
        self._take_until(time_ns, ends or {})
        self._measure(time_ns)

    def _take_until(self, time_ns: int, ends: Mapping[int, int]) -> None:
        for number, ready in self._ready.items():
            seen = ready.take(ends[number] if number in ends else ready.place_of(time_ns))
            if len(seen):
                # Of which clock the time stamps were, a file does not tell.
                self._loop.take(number, seen, time_ns * 1e-9, stamp_error_ns=None)

    def _measure(self, time_ns: int) -> None:
        self._now_ns = time_ns
        self._made += self._loop.measurements(time_ns * 1e-9, self._wall_offset_ns)
        for master in self._loop.masters.values():
            master.emergencies.clear()


class _Ready:
    """Frames of one bus that can be used, and how many of them were."""

    def __init__(self, seen: Frames) -> None:
        self.frames = seen
        self.syncs = np.flatnonzero((seen["can_id"] == SYNC_COB_ID) & (seen["flags"] & ECHO != 0)).tolist()
        self._newest_ns = np.maximum.accumulate(seen["time_ns"])
        self._used = 0

    def place_of(self, time_ns: int) -> int:
        """Return how many frames ended before a time."""
        return int(np.searchsorted(self._newest_ns, time_ns, "left"))

    def take(self, end: int) -> Frames:
        """Return the frames before place `end` that were not used yet."""
        first, self._used = self._used, max(self._used, end)
        return self.frames[first : self._used]


class Part(NamedTuple):
    """Part of a log: its frames by the number of their bus, its measurements, and the counters after it."""

    frames: dict[int, Frames]
    measurements: list[Measurement]
    status: GatewayStatus


def play(contract: Contract, logged: Mapping[int, Frames], calibrator: Calibrator | None = None) -> Iterator[Part]:
    """Yield a log part by part, with the measurements that its frames give.

    Parameters
    ----------
    logged : mapping of int to Frames
        Frames by the number of their bus, in the order of the log.
    calibrator : Calibrator, optional
        Puts offsets into the measurements.
    """
    newest_ns = {bus: np.maximum.accumulate(seen["time_ns"]) for bus, seen in logged.items()}
    parts = np.unique(np.concatenate([each // _PART_NS for each in newest_ns.values()]))
    playback = Playback(contract, logged.keys(), int(parts[0]) * _PART_NS, calibrator=calibrator)
    used = dict.fromkeys(logged, 0)
    for part in parts.tolist():
        until_ns = (part + 1) * _PART_NS - 1
        mine = {}
        for bus, seen in logged.items():
            begin, used[bus] = used[bus], int(np.searchsorted(newest_ns[bus], until_ns, "right"))
            mine[bus] = seen[begin : used[bus]]
            playback.feed(bus, mine[bus])
        yield Part(mine, playback.advance(until_ns), playback.status())
    yield Part({}, playback.finish(), playback.status())


def check_named(status: GatewayStatus) -> None:
    """Check, by the status after a log of frames, that its frames name the cycles of the log.

    Raises
    ------
    InputError
        If they do not: the log is another skin's, or of before the counter in each frame.
    """
    old = "logs of before the counter in each frame cannot be used any more"
    if not status.cycles:
        raise InputError(f"the log holds no SYNC with a counter (COB-ID {SYNC_COB_ID:02X}h, 1 byte): {old}")
    counts = status.frames
    if counts.accepted < counts.received / _NAMED:
        unnamed = f"{counts.received - counts.accepted} of {counts.received} frames with sums name no cycle of the log"
        raise InputError(f"{unnamed}: is this the skin's layout? And {old}")


def with_echoes(logged: Frames) -> Frames:
    """Return frames whose SYNCs, those with a counter, are marked as echoes, as the gateway that sent them sees."""
    counter = logged["data"][:, 0]
    is_sync = (logged["can_id"] == SYNC_COB_ID) & (logged["length"] == 1) & (counter >= 1) & (counter <= SYNC_OVERFLOW)
    is_sync &= logged["flags"] & (EXTENDED | REMOTE | ERROR | FD) == 0
    marked: Frames = logged.copy()
    marked["flags"][is_sync] |= ECHO
    return marked
