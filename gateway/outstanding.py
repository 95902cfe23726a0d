"""Window identity: which frames of an earlier cycle may still come after a SYNC.

A frame belongs to the SYNC before it on the bus, because a node gives up what has not gone within 1007h. A stack that
runs in a timer of 1 ms gives up late: after the next SYNC, if the window ends less than the timer's period before. So a
frame that did not come in a cycle may come in the next. There it would pass for the answer to the new SYNC.

Where nodes have two states, a SYNC asks for the frames of one. A node that missed the switch sends the others.
So after SYNCs that asked for other frames, the first cycle is doubtful. Where a node strayed (it sent meanwhile), the
second cycle is doubtful, too.

A bus is *unordered* if its interface does not prove that the echo of SYNC comes after SYNC was on the bus and before
the answers. There a SYNC may wait in the interface, and so may a frame, for any time. So nothing ends by time, and SYNC
counts from the moment before it is handed to the interface:

    owed = SYNCs handed over - frames that came >= frames that still may come

because a SYNC causes one frame of a row at most. A frame that comes while one is owed, and none was owed when SYNC n
was handed over, is the answer to SYNC n: nothing else could cause it. A frame that never comes stays owed. The gateway
resets the communication of such a node. Its boot-up message proves that nothing old follows, because a node sends no
PDO before it is started again, and interfaces send and receive first in, first out.
"""

from collections.abc import Collection
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from dbc.contract import Contract, FrameTable
from gateway.open_cycles import Flags, Integers
from shell.compiled import njit


class Outstanding(NamedTuple):
    """Frames that were asked for on a bus and have not come.

    Attributes
    ----------
    owed : array of int64, shape (rows,)
        How many frames of each row of `Contract.table` may come.
    asked_ns, window_ns : arrays of int64, shape (buses,)
        When the newest SYNC ended on each bus, and its window.
    rests : array of bool, shape (buses,)
        Whether the newest SYNC of a bus asked for none of these frames.
    strayed : array of bool, shape (rows,)
        Rows of nodes that sent these frames all the same.
    doubtful, may_be_old : arrays of bool, shape (rows,)
        Rows that are doubtful at the next SYNC for that; and rows whose frame may be the answer to a SYNC before the
        newest.
    is_silent : array of bool, shape (nodes,)
        Nodes that have sent nothing since they were last not proven; on unordered buses, since they last booted.
    is_ordered : array of bool, shape (buses,)
    cycles_behind : array of int64, shape (nodes,)
        On unordered buses: SYNCs in a row at which the node owed a frame.
    """

    owed: Integers
    asked_ns: Integers
    window_ns: Integers
    rests: Flags
    strayed: Flags
    doubtful: Flags
    may_be_old: Flags
    is_silent: Flags
    is_ordered: Flags
    cycles_behind: Integers


def new_outstanding(contract: Contract, unordered: Collection[int] = ()) -> Outstanding:
    """Return the state before the first SYNC; `unordered` are numbers of buses."""
    rows, buses = len(contract.table.cob_id), len(contract.layout.bus)
    asked_ns, window_ns = np.zeros((2, buses), np.int64)
    strayed, doubtful, may_be_old = np.zeros((3, rows), np.bool_)
    return Outstanding(
        np.zeros(rows, np.int64),
        asked_ns,
        window_ns,
        np.zeros(buses, np.bool_),
        strayed,
        doubtful,
        may_be_old,
        np.ones(len(contract.nodes), np.bool_),
        np.array([bus not in unordered for bus in range(buses)]),
        np.zeros(len(contract.nodes), np.int64),
    )


@njit(cache=True, nogil=True)
def ask(bus: int, time_ns: int, window_ns: int, table: FrameTable, frames: Outstanding) -> None:
    """Take note of a SYNC on a bus, and find the rows that `may_be_old`.

    Parameters
    ----------
    time_ns : int
        End of the SYNC, 0 if unknown.
    window_ns : int
        Within this time after the SYNC the nodes send (1007h).
    """
    is_first = frames.rests[bus]
    frames.rests[bus] = False
    has_passed = _note(bus, time_ns, window_ns, frames) and frames.is_ordered[bus]
    if not frames.is_ordered[bus]:
        _count_behind(bus, table, frames)
    for row in range(len(table.bus)):
        if table.bus[row] != bus:
            continue
        frames.may_be_old[row] = is_first or frames.owed[row] > 0 or frames.doubtful[row]
        frames.doubtful[row] = is_first and frames.strayed[row]
        frames.strayed[row] = False
        if has_passed:
            frames.owed[row] = 0  # after the window the nodes have given up; see the module for the next cycle
        frames.owed[row] += 1


@njit(cache=True, nogil=True)
def _count_behind(bus: int, table: FrameTable, frames: Outstanding) -> None:
    is_behind = np.zeros(len(frames.cycles_behind), np.bool_)
    for row in range(len(table.bus)):
        is_behind[table.node[row]] |= frames.owed[row] > 0
    for row in range(len(table.bus)):
        node = table.node[row]
        if table.bus[row] == bus and (row == 0 or table.node[row - 1] != node):  # rows are ordered by node
            frames.cycles_behind[node] = frames.cycles_behind[node] + 1 if is_behind[node] else 0


@njit(cache=True, nogil=True)
def rest(bus: int, time_ns: int, window_ns: int, table: FrameTable, frames: Outstanding) -> None:
    """Take note of a SYNC that asks for none of these frames; parameters as for `ask`."""
    _note(bus, time_ns, window_ns, frames)
    frames.rests[bus] = True
    for row in range(len(table.bus)):
        if table.bus[row] == bus:
            frames.owed[row] = 0


@njit(cache=True, nogil=True)
def _note(bus: int, time_ns: int, window_ns: int, frames: Outstanding) -> bool:
    """Keep the time of a SYNC; tell whether the window of the SYNC before has passed."""
    last_ns, last_window_ns = frames.asked_ns[bus], frames.window_ns[bus]
    frames.asked_ns[bus], frames.window_ns[bus] = time_ns, window_ns
    return not (time_ns != 0 and last_ns != 0 and time_ns - last_ns < last_window_ns)


@njit(cache=True, nogil=True)
def came(row: int, table: FrameTable, frames: Outstanding) -> None:
    """Take note of a frame."""
    node = table.node[row]
    frames.is_silent[node] = False
    frames.owed[row] = max(frames.owed[row] - 1, 0)
    if frames.rests[table.bus[row]]:
        for other in range(len(table.node)):
            frames.strayed[other] |= table.node[other] == node


def doubt(node: npt.NDArray[np.intp], frames: Outstanding) -> None:
    """Take note that nodes of an ordered bus are not proven now, or that nodes of any bus have booted."""
    frames.is_silent[node] = True


def prove(node: npt.NDArray[np.intp], table: FrameTable, frames: Outstanding) -> None:
    """Expect nothing of nodes that are proven and about to start: they have sent nothing since they were not."""
    fresh = np.zeros(len(frames.is_silent), np.bool_)
    fresh[node] = frames.is_silent[node]
    frames.owed[fresh[table.node]] = 0
