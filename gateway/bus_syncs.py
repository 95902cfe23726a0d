"""The SYNCs of the gateway on each bus: which is the newest there, and which came too close together."""

from typing import Final, NamedTuple

import numpy as np

from dbc.contract import Contract
from dbc.dictionary import STOCK_WINDOW_RATIO
from gateway.open_cycles import SLOTS, Flags, Integers, slot_of
from shell.compiled import njit

#: Two SYNCs whose ends are nearer than this part of a period are too close. The gateway itself keeps half a period.
CLOSE: Final = 0.4


class BusSyncs(NamedTuple):
    """The newest SYNCs, as the gateway sends them and as they are on the buses.

    Attributes
    ----------
    counter, end_ns : arrays of int64, shape (buses,)
        Counter of the newest SYNC on each bus, 0 before the first; and when this SYNC ended, 0 if unknown.
    due_counter, due_ns : arrays of int64, shape (SLOTS,)
        Counter and due time of the newest SYNCs that were sent, the oldest first; counter 0 for none.
    period_ns, window_ns : arrays of int64, shape (SLOTS,)
        By slot: time to the next SYNC, and the window of the answers (1007h).
    rests : array of bool, shape (SLOTS,)
        Whether the SYNC of a slot asks for no frame of this contract.
    """

    counter: Integers
    end_ns: Integers
    due_counter: Integers
    due_ns: Integers
    period_ns: Integers
    window_ns: Integers
    rests: Flags


def new_syncs(contract: Contract) -> BusSyncs:
    """Return the state before the first SYNC."""
    counter, end_ns = np.zeros((2, len(contract.layout.bus)), np.int64)
    due_counter, due_ns, period_ns, window_ns = np.zeros((4, SLOTS), np.int64)
    syncs = BusSyncs(counter, end_ns, due_counter, due_ns, period_ns, window_ns, np.zeros(SLOTS, np.bool_))
    for slot in range(SLOTS):
        _set_period(slot, contract.layout.sync.period_s, syncs)
    return syncs


def send_sync(counter: int, due_ns: int, period_s: float | None, syncs: BusSyncs, *, rests: bool) -> None:
    """Take note of a SYNC that is about to be sent.

    Parameters
    ----------
    period_s : float or None
        Time to the next SYNC; None: as before.
    rests : bool
        Whether the SYNC asks for no frame of this contract.
    """
    # A bus without SYNC since this counter was last used is not in this cycle.
    syncs.counter[syncs.counter == counter] = 0
    for newest, value in ((syncs.due_counter, counter), (syncs.due_ns, due_ns)):
        newest[:-1] = newest[1:]
        newest[-1] = value
    slot = slot_of(counter)
    syncs.rests[slot] = rests
    if period_s is not None:
        _set_period(slot, period_s, syncs)


def _set_period(slot: int, period_s: float, syncs: BusSyncs) -> None:
    syncs.period_ns[slot] = round(period_s * 1e9)
    syncs.window_ns[slot] = round(STOCK_WINDOW_RATIO * int(syncs.period_ns[slot]))


@njit(cache=True, nogil=True)
def begin_on_bus(bus: int, counter: int, time_ns: int, syncs: BusSyncs) -> bool:
    """Take note of an echo on a bus; tell whether sums of the bus may answer this SYNC or another.

    Parameters
    ----------
    counter : int
        0 in a SYNC without counter: it is the newest SYNC that was due at its time.
    time_ns : int
        End of the SYNC, 0 if unknown.
    """
    before, last_ns = syncs.counter[bus], syncs.end_ns[bus]
    now = counter
    if not now:
        for place in range(SLOTS):
            known = syncs.due_counter[place]
            if known and (not now or not time_ns or syncs.due_ns[place] <= time_ns):
                now = known
    syncs.counter[bus], syncs.end_ns[bus] = now, time_ns
    period_ns = syncs.period_ns[slot_of(before or now)]
    # SYNCs that waited in the controller end too close together.
    is_close = time_ns != 0 and last_ns != 0 and time_ns - last_ns < CLOSE * period_ns
    return bool(is_close or now == before)
