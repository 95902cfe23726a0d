"""Owed frames: which frames of an earlier cycle may still come after a SYNC.

A frame belongs to the SYNC before it on the bus, because a node gives up what has not gone within 1007h. But some
stacks give up late or never, and a board that hangs may send the answers to several SYNCs when it goes on. There they
would pass for the answers to newer SYNCs. So owed frames are counted: one more for each SYNC, one less for each frame
that comes. A frame is used only if none was owed when its SYNC came.

A frame that a node has given up never comes. So what is owed ends also when the node has shown that it holds nothing
back: the windows of the newest two SYNCs have passed, it has sent the frame once since the newest, and then nothing for
`QUIET_NS`, or the frame has come once for each of `STREAK` SYNCs in a row. A board that goes on sends what it held back
one frame after the other. What no counting finds is a node that stays a cycle late.

With two phases a SYNC asks for the frames of its own phase. A node sends the older frame first. So an answer to the
newest SYNC ends what the node owed of the other phase, if no such answer was owed when that SYNC came; else what ends
the debt of its own phase ends this one, too.

Where nodes have two states, a SYNC asks for the frames of one. A node that missed the switch sends the others.
So after SYNCs that asked for other frames, the first cycle is doubtful. Where a node strayed (it sent meanwhile), the
second cycle is doubtful, too.

A bus is *unordered* if its interface does not prove that the echo of SYNC comes after SYNC was on the bus and before
the answers. There a SYNC may wait in the interface, and so may a frame, for any time. So nothing ends by time, and SYNC
counts from the moment before it is handed to the interface:

    owed = SYNCs handed over - frames that came >= frames that still may come

because a SYNC causes one frame of a row at most. A frame that comes while one is owed, and none was owed when SYNC n
was handed over, is the answer to SYNC n: nothing else could cause it. A frame that never comes stays owed, unless a
frame of the other phase ends the debt. The gateway resets the communication of a node whose debt stays. Its boot-up
message proves that nothing old follows, because a node sends no PDO before it is started again, and interfaces send and
receive first in, first out.
"""

from collections.abc import Collection
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from dbc.contract import Contract, FrameTable
from gateway.open_cycles import Flags, Integers
from shell.compiled import njit

#: A node that goes on after it hung sends what it held back without a pause as long as this.
QUIET_NS: Final = 2_000_000
#: SYNCs in a row with one frame each after which a node that sends late in its cycle holds nothing back.
STREAK: Final = 3
#: In place of a phase: a SYNC that asks for the frames of every phase.
EVERY: Final = -1


class Outstanding(NamedTuple):
    """Frames that were asked for on a bus and have not come.

    Attributes
    ----------
    owed : array of int64, shape (rows,)
        How many frames of each row of `Contract.table` may come.
    came, streak : arrays of int64, shape (rows,)
        Frames of the row since the newest SYNC, and SYNCs in a row with one frame each.
    sent_ns : array of int64, shape (nodes,)
        End of the newest of these frames of a node, 0 if unknown.
    phase, asked_ns, window_ns : arrays of int64, shape (buses,)
        For which phase the newest SYNC of each bus asked, when it ended, and its window.
    has_passed : array of bool, shape (buses,)
        Whether the window of the SYNC before had passed then.
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
    came: Integers
    streak: Integers
    sent_ns: Integers
    phase: Integers
    asked_ns: Integers
    window_ns: Integers
    has_passed: Flags
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
    phase, asked_ns, window_ns = np.zeros((3, buses), np.int64)
    has_passed, rests = np.zeros((2, buses), np.bool_)
    strayed, doubtful, may_be_old = np.zeros((3, rows), np.bool_)
    owed, since_sync, streak = np.zeros((3, rows), np.int64)
    return Outstanding(
        owed,
        since_sync,
        streak,
        np.zeros(len(contract.nodes), np.int64),
        phase,
        asked_ns,
        window_ns,
        has_passed,
        rests,
        strayed,
        doubtful,
        may_be_old,
        np.ones(len(contract.nodes), np.bool_),
        np.array([bus not in unordered for bus in range(buses)]),
        np.zeros(len(contract.nodes), np.int64),
    )


@njit(cache=True, nogil=True)
def ask(  # noqa: PLR0917  compiled functions take no keywords
    bus: int, phase: int, time_ns: int, window_ns: int, table: FrameTable, frames: Outstanding
) -> None:
    """Take note of a SYNC on a bus, and find the rows that `may_be_old`.

    Parameters
    ----------
    phase : int
        For which frames it asks, `EVERY` if for all or unknown.
    time_ns : int
        End of the SYNC, 0 if unknown.
    window_ns : int
        Within this time after the SYNC the nodes send (1007h).
    """
    is_first = frames.rests[bus]
    frames.rests[bus] = False
    _end_debts(bus, time_ns, window_ns, table, frames)
    frames.phase[bus] = phase
    is_behind = np.zeros(len(frames.cycles_behind), np.bool_)
    for row in range(len(table.bus)):
        if table.bus[row] != bus:
            continue
        is_behind[table.node[row]] |= frames.owed[row] > 0
        if _is_asked(row, bus, table, frames):
            frames.may_be_old[row] = is_first or frames.owed[row] > 0 or frames.doubtful[row]
            frames.doubtful[row] = is_first and frames.strayed[row]
            frames.strayed[row] = False
            frames.owed[row] += 1
    if not frames.is_ordered[bus]:
        for row in range(len(table.bus)):
            node = table.node[row]
            if table.bus[row] == bus and (row == 0 or table.node[row - 1] != node):  # rows are ordered by node
                frames.cycles_behind[node] = frames.cycles_behind[node] + 1 if is_behind[node] else 0


@njit(cache=True, nogil=True)
def _is_asked(row: int, bus: int, table: FrameTable, frames: Outstanding) -> bool:
    """Tell whether the newest SYNC of the bus asked for a row."""
    phase = frames.phase[bus]
    return bool(phase == EVERY or table.phase[row] == phase)


@njit(cache=True, nogil=True)
def _end_debts(bus: int, time_ns: int, window_ns: int, table: FrameTable, frames: Outstanding) -> None:
    """At a SYNC, end what nodes owe that have shown since the SYNC before that they hold nothing back."""
    had_passed = frames.has_passed[bus]
    frames.has_passed[bus] = _note(bus, time_ns, window_ns, frames)
    is_over = had_passed and frames.has_passed[bus] and frames.is_ordered[bus]
    has_shown = np.zeros(len(frames.sent_ns), np.bool_)
    for row in range(len(table.bus)):
        if table.bus[row] != bus or not _is_asked(row, bus, table, frames):
            continue
        frames.streak[row] = frames.streak[row] + 1 if frames.came[row] == 1 else 0
        sent_ns = frames.sent_ns[table.node[row]]
        is_quiet = sent_ns != 0 and time_ns - sent_ns >= QUIET_NS
        is_paid = is_over and frames.came[row] == 1 and (is_quiet or frames.streak[row] >= STREAK)
        if is_paid:
            frames.owed[row] = 0
        has_shown[table.node[row]] |= is_paid or (frames.came[row] > 0 and not frames.may_be_old[row])
    for row in range(len(table.bus)):
        if table.bus[row] == bus:
            frames.came[row] = 0
            if has_shown[table.node[row]] and not _is_asked(row, bus, table, frames):
                frames.owed[row] = 0


@njit(cache=True, nogil=True)
def rest(bus: int, time_ns: int, window_ns: int, table: FrameTable, frames: Outstanding) -> None:
    """Take note of a SYNC that asks for none of these frames, which have one phase; parameters as for `ask`."""
    _note(bus, time_ns, window_ns, frames)
    frames.rests[bus] = True
    for row in range(len(table.bus)):
        if table.bus[row] == bus:
            frames.owed[row] = frames.came[row] = 0


@njit(cache=True, nogil=True)
def _note(bus: int, time_ns: int, window_ns: int, frames: Outstanding) -> bool:
    """Keep the time of a SYNC; tell whether the window of the SYNC before has passed."""
    last_ns, last_window_ns = frames.asked_ns[bus], frames.window_ns[bus]
    frames.asked_ns[bus], frames.window_ns[bus] = time_ns, window_ns
    return not (time_ns != 0 and last_ns != 0 and time_ns - last_ns < last_window_ns)


@njit(cache=True, nogil=True)
def came(row: int, time_ns: int, table: FrameTable, frames: Outstanding) -> None:
    """Take note of a frame that ended at `time_ns`, 0 if unknown."""
    node = table.node[row]
    frames.came[row] += 1
    frames.sent_ns[node] = time_ns
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
