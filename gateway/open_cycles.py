"""The frames of the cycles that are gathered at once: frames of a cycle may be read after the next SYNC was sent."""

from typing import Final

import numpy as np
import numpy.typing as npt

from dbc.contract import Contract

#: Cycles that are gathered at once.
SLOTS: Final = 2

Rows = npt.NDArray[np.intp]


def slot_of(counter: int) -> int:
    """Return the slot of a cycle; with two phases it is the phase."""
    return (counter - 1) % SLOTS


class OpenCycles:
    """What came in each open cycle, by slot and row of `Contract.table`. Cycles are named by the counter of their SYNC.

    Attributes
    ----------
    payload : array of uint8, shape (SLOTS, rows, bytes)
        Data of the frames.
    seen : array of bool, shape (SLOTS, rows)
        Whether a frame came.
    """

    def __init__(self, contract: Contract) -> None:
        table, buses = contract.table, len(contract.layout.bus)
        rows = len(table.cob_id)
        self.payload = np.zeros((SLOTS, rows, int(table.length.max())), np.uint8)
        self.seen = np.zeros((SLOTS, rows), np.bool_)
        self._bus = table.bus
        #: Frames whose sums are not to be used.
        self._spoilt = np.zeros((SLOTS, rows), np.bool_)
        #: Buses whose next cycle is spoilt, too.
        self._is_disturbed = np.zeros(buses, np.bool_)
        #: Counter of the SYNC of each slot, 0 for none.
        self._counter = [0] * SLOTS
        #: Frames that a cycle waits for, and how many of them have not come, by bus.
        self._awaited = np.zeros((SLOTS, rows), np.bool_)
        self._waiting = np.zeros((SLOTS, buses), np.intp)

    def begin(self, counter: int, awaited: Rows) -> None:
        """Begin a cycle that waits for the frames of the rows `awaited`."""
        slot = slot_of(counter)
        self._counter[slot] = counter
        self.seen[slot] = False
        self._spoilt[slot] = self._is_disturbed[self._bus]
        self._is_disturbed[:] = False
        self._awaited[slot] = False
        self._awaited[slot, awaited] = True
        self._waiting[slot] = np.bincount(self._bus[awaited], minlength=self._waiting.shape[1])

    def end(self, counter: int) -> None:
        """End the cycle in the slot of a SYNC, if there is one."""
        self._counter[slot_of(counter)] = 0

    def is_open(self, counter: int) -> bool:
        """Tell whether the cycle of a SYNC is open."""
        return counter != 0 and self._counter[slot_of(counter)] == counter

    def waiting(self, counter: int) -> npt.NDArray[np.intp]:
        """Return how many frames a cycle waits for, shape (buses,); a view."""
        waiting: npt.NDArray[np.intp] = self._waiting[slot_of(counter)]
        return waiting

    def spoil_bus(self, bus: int) -> None:
        """Use no sums of a bus in the open cycles, nor in the next cycle."""
        self._is_disturbed[bus] = True
        self._spoilt[:, self._bus == bus] = True

    def spoil(self, counter: int, rows: Rows) -> None:
        """Use no sums of these rows in an open cycle."""
        self._spoilt[slot_of(counter), rows] = True

    def spoilt(self, counter: int, rows: Rows) -> npt.NDArray[np.bool_]:
        """Tell whose sums are not to be used in a cycle."""
        spoilt: npt.NDArray[np.bool_] = self._spoilt[slot_of(counter), rows]
        return spoilt

    def take(self, counter: int, bus: int, row: Rows, payload: npt.NDArray[np.uint8]) -> int:
        """Keep the frames of a bus that came in an open cycle; return how many came for the first time.

        A repeated frame with other data (two nodes share a node-ID) spoils its row.
        """
        slot = slot_of(counter)
        first = np.zeros(len(row), np.bool_)
        first[np.unique(row, return_index=True)[1]] = True
        first &= ~self.seen[slot, row]
        fresh = row[first]
        self.payload[slot, fresh] = payload[first]
        self.seen[slot, fresh] = True
        self._waiting[slot, bus] -= self._awaited[slot, fresh].sum()
        if len(fresh) < len(row):
            repeated = row[~first]
            differs = (self.payload[slot, repeated] != payload[~first]).any(axis=1)
            self._spoilt[slot, repeated[differs]] = True
        return len(fresh)
