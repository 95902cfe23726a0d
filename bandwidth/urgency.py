"""Response times of adaptive nodes: how long news, refreshes, details and heartbeats wait when everything moves.

Only news that has waited for `SendingRule.patience` has the highest level. A group that was sent needs as long to come
back to that level, whatever moves. So the frames of this level are sporadic messages with that least distance, and the
analysis of Davis et al. (`bandwidth.response`) bounds their response time. The pause after a SYNC counts as a message
above all of them: with J the jitter, τ a bit, B the longest frame, C the longest coarse frame, W the patience and P the
time of a pause with its SYNC and a frame, the longest wait at the highest level is

    w = B + ⌈(w + J + τ) / SYNC period⌉ P + Σ ⌈(w + J + τ) / W⌉ C    over all frames of that level that go first

and news is shown after W + J + w + C. A bound exists if P / SYNC period + (frames of that level) C / W < 1.

A gateway that joins, or that has lost frames, stops all N nodes, proves them and starts them again. With D dialogues
at a time, A the longest time until a node acts on a frame and the gateway reads the answer, F the time of the frames of
this quiet time on an arbitrated bus (those that controllers still hold, stops, proofs, heartbeats), and S the time of
an NMT start and a frame that goes before, the nodes start after

    max(F + ⌈N / D⌉ A, QUIET_S) + TICK_S + A + N S

Each of them then owes all its groups, as refreshes that are due: the last comes within the bound of a refresh, or where
nothing moves within that of a bus that comes to rest.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
import numpy.typing as npt

from bandwidth.response import ERROR_BITS, UNBOUNDED, arrivals, response_times_ns
from bandwidth.traffic import Disturbance, Traffic, traffic
from dbc.adaptive import FIRST_COB_ID, LEVELS, PAUSE_MS, SAVED_FRAMES, SAVING_S, SendingRule, carried, cob_id, column_of
from dbc.adaptive_filter import SAMPLE_NS
from dbc.configuration import DIALOGUES, QUIET_S, READ_S, TICK_S
from dbc.contract import Contract, sum_frame, sum_frame_bits
from dbc.dictionary import HEARTBEAT_MS
from dbc.frame_bits import frame_time_ns, nominal_ns

Nanoseconds = npt.NDArray[np.int64]

_MS: Final = 1_000_000
_RULE: Final = SendingRule()
#: A refresh reaches the highest level after this time.
OVERDUE_NS: Final = (LEVELS - 1) * _RULE.overdue * _MS
#: What waits for more pauses has no bound.
_PAUSES_MAX: Final = 1000


@dataclass(frozen=True, eq=False)
class Urgency:
    """The waiting times of one bus with adaptive nodes.

    Attributes
    ----------
    streams : Traffic
        SYNC, SDO transfers and heartbeats.
    allowed : Disturbance
        `jitter_s` is the longest time from a sample until its frame is queued.
    nodes : int
    groups : int
        Of sums, of a node.
    """

    streams: Traffic
    allowed: Disturbance
    nodes: int
    groups: int

    @classmethod
    def of(cls, contract: Contract, bus: int, allowed: Disturbance) -> "Urgency":
        """Return the waiting times of bus number `bus`."""
        streams = traffic(contract, bus, allowed=allowed)
        return cls(streams, allowed.of(contract.layout), len(contract.on_bus(bus)), contract.layout.groups)

    @cached_property
    def frame_ns(self) -> int:
        """Longest frame of sums, a fine one, with the most stuff bits."""
        return self._frame_ns(is_fine=True)

    @cached_property
    def coarse_frame_ns(self) -> int:
        """Longest coarse frame, with the most stuff bits."""
        return self._frame_ns(is_fine=False)

    def _frame_ns(self, *, is_fine: bool) -> int:
        line = self.streams.bus
        return int(
            frame_time_ns(sum_frame(line, self.groups, is_fine=is_fine), line.bitrate, line.data_bitrate, "worst")[0]
        )

    @property
    def frames_of_node(self) -> int:
        """Frames that tell all sums of a node: one for each group, or on CAN FD for up to four."""
        return self.groups // carried(self.groups, self.streams.bus.fd)

    @property
    def sync_ns(self) -> int:
        """Longest SYNC."""
        return int(self.streams.worst_ns[self._sync])

    @property
    def period_ns(self) -> int:
        """Time between two SYNCs."""
        return round(float(self.streams.period_s[self._sync]) * 1e9)

    @property
    def _sync(self) -> int:
        """Place of SYNC among the streams: frames of other devices may come before."""
        return int(np.flatnonzero(self.streams.is_cyclic)[0])

    @property
    def jitter_ns(self) -> int:
        """Longest time from a sample until its frame is queued."""
        return round((self.allowed.jitter_s or 0.0) * 1e9)

    @cached_property
    def above(self) -> list[tuple[int, int, int]]:
        """Time, period and jitter of what keeps the bus from all sums: pauses, other devices, and errors.

        A frame of another kind that has begun in a pause may reach beyond the end of the pause. An error has the frame
        sent again.
        """
        rows = [(self.sync_ns + PAUSE_MS * _MS + self.frame_ns, self.period_ns, self.jitter_ns)]
        foreign, time = self.streams.is_foreign, self.streams.worst_ns
        rows += [
            (int(time[place]), round(float(self.streams.period_s[place]) * 1e9), 0) for place in np.flatnonzero(foreign)
        ]
        return rows + self._errors

    @property
    def _foreign_frame_ns(self) -> int:
        return int(self.streams.worst_ns[self.streams.is_foreign].max(initial=0))

    @property
    def _errors(self) -> list[tuple[int, int, int]]:
        if not self.allowed.errors_per_s:
            return []
        error_ns = nominal_ns(ERROR_BITS, self.streams.bus.bitrate) + self.frame_ns
        return [(error_ns, round(1e9 / self.allowed.errors_per_s), self.frame_ns)]

    def _responses(self, each_ns: int, count: int, period_ns: int, jitter_ns: int) -> Nanoseconds:
        """Return the response times of `count` frames of sums by falling priority, each once in `period_ns`."""
        rows = np.array([*self.above, *[(each_ns, period_ns, jitter_ns)] * count], np.int64)
        found = response_times_ns(
            *rows.T,
            bit_ns=nominal_ns(1, self.streams.bus.bitrate),
            blocked_ns=np.full(len(rows), max(self.frame_ns, self._foreign_frame_ns)),
        )
        return found[len(self.above) :]

    @cached_property
    def top_ns(self) -> Nanoseconds:
        """From the highest level to the end of the frame, shape (nodes, frames of a node).

        `UNBOUNDED` without a bound.
        """
        shape = self.nodes, self.frames_of_node
        period_ns = _RULE.patience * _MS
        by_priority = self._responses(self.coarse_frame_ns, math.prod(shape), period_ns, self.jitter_ns)
        together = self.groups // shape[1]
        line = self.streams.bus
        columns = [column_of(each, self.groups, is_fd=line.fd) for each in line.ids]
        identifiers = [
            cob_id(columns[node], LEVELS - 1, together * frame, False, self.groups) for node, frame in np.ndindex(shape)
        ]
        rank = np.argsort(np.argsort(identifiers))
        return by_priority[rank].reshape(shape)

    @property
    def news_ns(self) -> Nanoseconds:
        """From the sample that is first news to the end of its group's coarse frame, shape as `top_ns`."""
        return _after(_RULE.patience * _MS, self.top_ns)

    @property
    def refresh_ns(self) -> Nanoseconds:
        """From the time when a refresh is due to the end of its frame, shape as `top_ns`; the group has no news."""
        return _after(OVERDUE_NS, self.top_ns)

    @property
    def settled_ns(self) -> tuple[int, int]:
        """From the moment when all sums of the bus stay as they are until all are shown coarse, and fine.

        Each group then sends one coarse frame at most (news, or a refresh) until its next refresh is due. On CAN FD the
        refresh of another group may begin the wait for details anew.
        """
        between_ns, count = _RULE.refresh * _MS, self.frames_of_node * self.nodes
        coarse_ns = int(self._responses(self.coarse_frame_ns, count, between_ns, self.jitter_ns + _MS)[-1])
        if coarse_ns > between_ns:
            return UNBOUNDED, UNBOUNDED
        # Details that waited for the coarse frame, and refreshes that came due meanwhile.
        late_ns = int(self._responses(self.frame_ns, 2 * count, between_ns, self.jitter_ns + _MS)[-1])
        waits = 2 if self.streams.bus.fd else 1
        fine_ns = coarse_ns + waits * _RULE.fine_wait * _MS + late_ns
        return coarse_ns, UNBOUNDED if late_ns > between_ns else fine_ns

    @property
    def joined_ns(self) -> tuple[int, int]:
        """From the moment when a gateway joins, or notices a loss, until all groups of the bus have come.

        While nothing moves, and while everything moves; every node is there and has the right configuration.
        """
        longest_ns = max(self.frame_ns, int(self.streams.worst_ns.max()))
        # Held frames, two of the proof, a heartbeat, and an NMT command.
        count = (self.frames_of_node + 4) * self.nodes
        busy_ns = int(self._responses(longest_ns, count, HEARTBEAT_MS * _MS, self.jitter_ns)[-1])
        if busy_ns > HEARTBEAT_MS * _MS:
            return UNBOUNDED, UNBOUNDED
        answer_ns = SAMPLE_NS + self.jitter_ns + round(READ_S * 1e9)
        proofs_ns = busy_ns + -(-self.nodes // DIALOGUES) * answer_ns
        quiet_ns = max(proofs_ns, round(QUIET_S * 1e9))
        started_ns = quiet_ns + round(TICK_S * 1e9) + answer_ns + 2 * self.nodes * longest_ns
        return _sum(started_ns, self.settled_ns[0]), _sum(started_ns, int(self.refresh_ns.max()))

    @cached_property
    def service_ns(self) -> Nanoseconds:
        """Response time of each of `streams` but SYNC, when sums leave them the pauses only, shape (n,).

        A pause has room from the end of SYNC, which one frame of sums may delay, to `PAUSE_MS` after SYNC was due.
        """
        room_ns = PAUSE_MS * _MS - self.frame_ns - self.sync_ns
        time, period = self.streams.worst_ns, np.rint(self.streams.period_s * 1e9).astype(np.int64)
        found = np.full(len(time), UNBOUNDED, np.int64)
        is_service = ~self.streams.is_cyclic
        for place in np.flatnonzero(is_service).tolist():
            ahead = np.flatnonzero(is_service[:place])
            found[place] = self._in_pauses(place, time, list(zip(time[ahead], period[ahead], strict=True)), room_ns)
        return found

    @property
    def foreign_ns(self) -> Nanoseconds:
        """Response time of each foreign stream, shape (n,): those before all sums need not wait for a pause."""
        first = self.streams.is_foreign & (self.streams.frames["can_id"] < FIRST_COB_ID) & ~self.streams.is_extended
        count = int(np.flatnonzero(first)[-1]) + 1 if first.any() else 0
        free_ns = self.streams.responses_ns(self.allowed.errors_per_s, blocked_ns=self.frame_ns)
        return np.where(np.arange(len(first)) < count, free_ns, self.service_ns)[self.streams.is_foreign]

    def _in_pauses(self, place: int, time: Nanoseconds, before: list[tuple[int, int]], room_ns: int) -> int:
        ahead = [*((each_ns, interval_ns) for each_ns, interval_ns, _ in self._errors), *before]
        blocked = int(time[place + 1 :].max(initial=0))
        for pauses in range(1, _PAUSES_MAX):
            span_ns = pauses * self.period_ns
            left_ns: int = blocked - (pauses - 1) * room_ns
            left_ns += sum(int(arrivals(span_ns, 0, interval_ns)) * each_ns for each_ns, interval_ns in ahead)
            if left_ns < room_ns:
                return int(self.jitter_ns + span_ns - room_ns + max(left_ns, 0) + time[place])
        return UNBOUNDED


@dataclass(frozen=True)
class Budgeted:
    """The waiting times of a bus whose nodes have a budget of `bits_per_s` (2034h); `UNBOUNDED` without a bound.

    A frame takes `frame_bits` of its node's budget. A node saves up `saved_bits`.
    """

    urgency: Urgency
    bits_per_s: int

    @property
    def frame_bits(self) -> int:
        """Bits that a frame takes of a budget: those of the longest."""
        return sum_frame_bits(self.urgency.streams.bus, self.urgency.groups, is_fine=True)

    @property
    def least_bits_per_s(self) -> int:
        """Bits that the refreshes of a node take, which no budget holds back: a smaller budget limits nothing."""
        return math.ceil(self.urgency.frames_of_node * self.frame_bits * 1000 / _RULE.refresh_max)

    @property
    def saved_bits(self) -> float:
        """Bits that a node can save up."""
        return max(SAVED_FRAMES * self.urgency.groups * self.frame_bits, SAVING_S * self.bits_per_s)

    @cached_property
    def full_ns(self) -> int:
        """Longest time that the bus is full: what the nodes have saved up, what they get meanwhile, and pauses.

        Each node may owe the bits of a refresh of each group, which no budget holds back.
        """
        bit_ns, nodes = nominal_ns(1, self.urgency.streams.bus.bitrate), self.urgency.nodes
        owed_bits = self.urgency.frames_of_node * self.frame_bits
        at_once_ns = nodes * (self.saved_bits + owed_bits) * bit_ns + self.urgency.frame_ns
        share = nodes * self.bits_per_s * bit_ns * 1e-9
        share += sum(each_ns / interval_ns for each_ns, interval_ns, _ in self.urgency.above)
        if share >= 1:
            return UNBOUNDED
        for each_ns, interval_ns, jitter_ns in self.urgency.above:
            at_once_ns += (1 + jitter_ns / interval_ns) * each_ns
        return round(at_once_ns / (1 - share))

    def _saving_ns(self, groups: int, owed: int) -> int:
        """Return how long the last of some groups waits for bits, behind frames owed; each comes once in patience."""
        time_ns = round(self.frame_bits / self.bits_per_s * 1e9)
        rows = np.array([(time_ns, _RULE.patience * _MS, self.urgency.jitter_ns)] * groups, np.int64)
        blocked = np.full(groups, owed * time_ns)
        return int(response_times_ns(*rows.T, blocked_ns=blocked)[-1])

    @property
    def coarse_ns(self) -> int:
        """From the sample that is first news to the end of the coarse frame, for any group.

        A node owes a refresh of each group, and a frame of less urgent news, when a group reaches the highest level.
        Waiting for bits brings a group no nearer to its next frame of that level, so that those of the others are as
        far apart as without a budget.
        """
        top_ns, count = int(self.urgency.top_ns.max()), self.urgency.frames_of_node
        return _sum(_RULE.patience * _MS, self._saving_ns(count, count + 1), top_ns)

    @property
    def fine_ns(self) -> int:
        """From the sample that has details to the end of their frame, for a node whose coarse sums stay as they are.

        Details of all groups leave bits for a coarse frame of each; refreshes may have left the node in debt.
        """
        count = SAVED_FRAMES * self.urgency.groups + self.urgency.frames_of_node + 1
        saving_ns = round(count * self.frame_bits / self.bits_per_s * 1e9)
        return _sum(_RULE.fine_wait * _MS, saving_ns, self.urgency.jitter_ns, self.full_ns)


def _sum(*times_ns: int) -> int:
    return UNBOUNDED if UNBOUNDED in times_ns else sum(times_ns)


def _after(first_ns: int, then_ns: Nanoseconds) -> Nanoseconds:
    return np.where(then_ns < UNBOUNDED, first_ns + np.minimum(then_ns, UNBOUNDED - first_ns), UNBOUNDED)
