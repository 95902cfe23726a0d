"""The frames of the cycles that are gathered at once: frames of a cycle may be read after the next SYNC was sent."""

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from dbc.contract import Contract, FrameTable
from dbc.frame_fields import Flags, Integers
from shell.compiled import njit
from skin.sync_counter import SYNC_OVERFLOW, next_counter

#: Cycles that are gathered at once.
SLOTS: Final = 2


following = njit(cache=True, nogil=True)(next_counter)


@njit(cache=True, nogil=True)
def slot_of(counter: int) -> int:
    """Return the slot of a cycle."""
    return (counter - 1) % SLOTS


class OpenCycles(NamedTuple):
    """What came in each open cycle, by slot and row of `Contract.table`. Cycles are named by the counter of their SYNC.

    Attributes
    ----------
    counter : array of int64, shape (SLOTS,)
        Counter of the SYNC of each slot, 0 for none.
    payload : array of uint8, shape (SLOTS, rows, bytes)
        Data of the frames.
    seen, spoilt, awaited : arrays of bool, shape (SLOTS, rows)
        Whether a frame came, whether its sums are not to be used, and whether the cycle waits for it.
    waiting : array of int64, shape (SLOTS, buses)
        How many of the awaited frames have not come.
    passed : array of bool, shape (SLOTS, buses)
        Whether a frame of the next cycle came on the bus: its nodes have given up what they have not sent (1007h).
    tainted : array of bool, shape (buses, SYNC_OVERFLOW + 1)
        Counters of coming cycles that a foreign SYNC on the bus had.
    """

    counter: Integers
    payload: npt.NDArray[np.uint8]
    seen: Flags
    spoilt: Flags
    awaited: Flags
    waiting: Integers
    passed: Flags
    tainted: Flags


def new_cycles(contract: Contract) -> OpenCycles:
    """Return the state without any open cycle."""
    rows, buses = len(contract.table.cob_id), len(contract.layout.bus)
    return OpenCycles(
        counter=np.zeros(SLOTS, np.int64),
        payload=np.zeros((SLOTS, rows, int(contract.table.length.max(initial=0))), np.uint8),
        seen=np.zeros((SLOTS, rows), np.bool_),
        spoilt=np.zeros((SLOTS, rows), np.bool_),
        awaited=np.zeros((SLOTS, rows), np.bool_),
        waiting=np.zeros((SLOTS, buses), np.int64),
        passed=np.zeros((SLOTS, buses), np.bool_),
        tainted=np.zeros((buses, SYNC_OVERFLOW + 1), np.bool_),
    )


@njit(cache=True, nogil=True)
def begin_cycle(counter: int, is_awaited: Flags, table: FrameTable, cycles: OpenCycles) -> None:
    """Begin a cycle that waits for the frames of the rows `is_awaited`."""
    slot = slot_of(counter)
    cycles.counter[slot] = counter
    cycles.seen[slot] = False
    cycles.waiting[slot] = 0
    cycles.passed[slot] = False
    for row in range(len(table.bus)):
        bus = table.bus[row]
        cycles.spoilt[slot, row] = cycles.tainted[bus, counter]
        cycles.awaited[slot, row] = is_awaited[row]
        cycles.waiting[slot, bus] += is_awaited[row]
    # Foreign SYNCs with its counter, and those that were behind: not met within 120 SYNCs.
    cycles.tainted[:, counter] = False
    cycles.tainted[:, (counter + SYNC_OVERFLOW // 2 - 1) % SYNC_OVERFLOW + 1] = False


@njit(cache=True, nogil=True)
def is_open(counter: int, cycles: OpenCycles) -> bool:
    """Tell whether the cycle of a SYNC is open."""
    return counter != 0 and cycles.counter[slot_of(counter)] == counter


@njit(cache=True, nogil=True)
def spoil_bus(bus: int, table: FrameTable, cycles: OpenCycles) -> None:
    """Use no sums of a bus in the open cycles."""
    for row in range(len(table.bus)):
        if table.bus[row] == bus:
            cycles.spoilt[:, row] = True


@njit(cache=True, nogil=True)
def keep_frame(slot: int, bus: int, row: int, data: npt.NDArray[np.uint8], cycles: OpenCycles) -> bool:
    """Keep a frame of a bus that names an open cycle; return whether it came for the first time.

    A repeated frame with other data (two nodes share a node-ID) spoils its row.
    """
    other = 1 - slot
    if cycles.counter[other] and following(cycles.counter[other]) == cycles.counter[slot]:
        cycles.passed[other, bus] = True
    payload = cycles.payload[slot, row]
    if cycles.seen[slot, row]:
        for byte in range(len(payload)):
            if payload[byte] != data[byte]:
                cycles.spoilt[slot, row] = True
        return False
    for byte in range(len(payload)):
        payload[byte] = data[byte]
    cycles.seen[slot, row] = True
    cycles.waiting[slot, bus] -= cycles.awaited[slot, row]
    return True
