"""When each SYNC is due. Times are absolute; two SYNCs are never close together; late SYNCs are skipped and counted."""

from typing import Final

from skin.sync_counter import next_counter

#: Part of a period. A SYNC is skipped when it is later than this, or nearer than this to the SYNC before.
LATEST: Final = 0.5
#: Fewer SYNCs have no rate: that of n SYNCs is up to 1 / n too high.
RATE_SYNCS: Final = 20


class SyncClock:
    """The times of the SYNCs.

    Attributes
    ----------
    period_s : float
        From SYNC to SYNC.
    due_s : float
        When the next SYNC is due; infinite before `start`.
    counter : int
        Counter of the newest SYNC, 0 before the first.
    sent, skipped : int
        Number of SYNCs since the start.
    """

    def __init__(self, period_s: float) -> None:
        self.due_s = float("inf")
        self.counter = 0
        self.sent = self.skipped = 0
        self.period_s = period_s
        self._start_s = self._sent_s = float("-inf")

    @property
    def runs(self) -> bool:
        """Whether SYNCs are due at all."""
        return self.due_s != float("inf")

    def start(self, first_s: float) -> None:
        """Begin with a SYNC at `first_s`."""
        self._start_s = self.due_s = first_s

    def stop(self) -> None:
        """Send no more."""
        self.due_s = float("inf")

    def take(self, now_s: float) -> float | None:
        """Return the due time of the SYNC to send now, None when no SYNC is due.

        A late SYNC does not move the next. After a stall the missed SYNCs are skipped: nodes would answer two SYNCs
        close together with two bursts, more than the bus carries.
        """
        if now_s < self.due_s:
            return None
        missed = int((now_s - self.due_s) / self.period_s)
        due_s = self.due_s + missed * self.period_s
        is_late = now_s - due_s > LATEST * self.period_s or now_s - self._sent_s < LATEST * self.period_s
        self.skipped += missed + is_late
        self.due_s = due_s + self.period_s
        if is_late:
            return None
        self._sent_s = now_s
        self.sent += 1
        self.counter = next_counter(self.counter) if self.counter else 1
        return due_s

    def rate_hz(self, now_s: float) -> float:
        """Return the mean rate of the SYNCs sent so far, 0 of too few."""
        return mean_rate_hz(self.sent, now_s - self._start_s)


def mean_rate_hz(syncs: int, elapsed_s: float) -> float:
    """Return the mean rate of SYNCs since the first; 0 of fewer than `RATE_SYNCS`."""
    return syncs / elapsed_s if syncs >= RATE_SYNCS and elapsed_s > 0 else 0.0
