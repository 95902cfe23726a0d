"""The SYNCs of the gateway on each bus: which is the newest there, and which came too close together."""

from collections import deque
from typing import Final

from dbc.contract import Contract
from gateway.open_cycles import SLOTS, slot_of

#: Two SYNCs whose ends are nearer than this part of a period are too close. The gateway itself keeps half a period.
CLOSE: Final = 0.4


class BusSyncs:
    """The newest SYNCs, as the gateway sends them and as they are on the buses.

    Attributes
    ----------
    counter : list of int
        By bus: counter of the newest SYNC, 0 before the first.
    """

    def __init__(self, contract: Contract) -> None:
        buses = len(contract.layout.bus)
        self.counter = [0] * buses
        #: By bus: when the newest SYNC ended, 0 if unknown.
        self._end_ns = [0] * buses
        #: Counter and due time of the newest SYNCs, the oldest first.
        self._due: deque[tuple[int, int]] = deque(maxlen=SLOTS)
        #: By slot: time to the next SYNC, and whether the SYNC asks for no frame of this contract.
        self._period_ns = [round(contract.layout.sync.period_s * 1e9)] * SLOTS
        self._rests = [False] * SLOTS

    def send(self, counter: int, due_ns: int, period_s: float | None, *, rests: bool) -> None:
        """Take note of a SYNC that is about to be sent.

        Parameters
        ----------
        period_s : float or None
            Time to the next SYNC; None: as before.
        rests : bool
            Whether the SYNC asks for no frame of this contract.
        """
        # A bus without SYNC since this counter was last used is not in this cycle.
        self.counter = [0 if now == counter else now for now in self.counter]
        self._due.append((counter, due_ns))
        slot = slot_of(counter)
        self._rests[slot] = rests
        if period_s is not None:
            self._period_ns[slot] = round(period_s * 1e9)

    def begin(self, bus: int, counter: int, time_ns: int) -> bool:
        """Take note of an echo on a bus; tell whether sums of the bus may answer this SYNC or another.

        Parameters
        ----------
        counter : int
            0 in a SYNC without counter: it is the newest SYNC that was due at its time.
        time_ns : int
            End of the SYNC, 0 if unknown.
        """
        before, last_ns = self.counter[bus], self._end_ns[bus]
        self.counter[bus] = counter or self._counter_at(time_ns)
        self._end_ns[bus] = time_ns
        period_ns = self._period_ns[slot_of(before or self.counter[bus])]
        # SYNCs that waited in the controller end too close together.
        is_close = bool(time_ns and last_ns and time_ns - last_ns < CLOSE * period_ns)
        return is_close or self.counter[bus] == before

    def rests(self, bus: int) -> bool:
        """Tell whether the newest SYNC of a bus asks for no frame of this contract."""
        return self._rests[slot_of(self.counter[bus])]

    def period_ns(self, bus: int) -> int:
        """Return the time from the newest SYNC of a bus to the next."""
        return self._period_ns[slot_of(self.counter[bus])]

    def _counter_at(self, time_ns: int) -> int:
        """Return the counter of the newest SYNC that was due at a time, 0 before the first."""
        newest = self._due[0][0] if self._due else 0
        for counter, due_ns in self._due:
            if not time_ns or due_ns <= time_ns:
                newest = counter
        return newest
