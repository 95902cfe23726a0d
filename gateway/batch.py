"""A batch of received frames, looked through once: what each part of the gateway needs of it."""

from typing import Final, NamedTuple

import numpy as np

from bus.error_frames import ErrorClass
from dbc.canopen import (
    BASE_ID_MASK,
    EMCY_BASE,
    HIGHEST_NODE_ID,
    NMT_COB_ID,
    SDO_REQUEST_BASE,
    SDO_RESPONSE_BASE,
    SYNC_COB_ID,
)
from dbc.contract import FrameTable, PartTable
from dbc.frame import CAN_ID_AT, DATA_AT, ECHO, ERROR, EXTENDED, FD, FLAGS_AT, LENGTH_AT, REMOTE, Frames, frame_bytes
from dbc.frame_fields import Bytes, Integers, field
from shell.compiled import borrowed, njit
from skin.sync_counter import SYNC_OVERFLOW

#: In place of a place in the table of the frames with sums: nothing to count; none with sums; of a wrong length, or
#: without number of its cycle or slot; SYNC of the gateway, and of somebody else.
NOTHING, STRANGE, WRONG, OWN_SYNC, OTHER_SYNC = -1, -2, -3, -4, -5
#: Byte 1 of a report of the controller: its receive buffer has overflowed (SocketCAN: CAN_ERR_CRTL_RX_OVERFLOW).
_OVERFLOW: Final = 0x01
#: Plain numbers for compiled code.
_OFF: Final = int(ErrorClass.BUS_OFF | ErrorClass.RESTARTED)
_CONTROLLER: Final = int(ErrorClass.CONTROLLER)


class Batch(NamedTuple):
    """Frames of a bus, in bus order.

    Attributes
    ----------
    bus : int
        Number of the bus.
    rows : array of uint8, shape (frames, bytes of a FRAME)
    places : array of int64, shape (frames,)
        Place of each frame in the table of the frames with sums, or `NOTHING` to `OTHER_SYNC`.
    tells_loss : bool
        A report of the controller among them says that it received nothing for a time.
    echoes : int
        Number of the gateway's own commands and SDO requests, which were on the bus.
    other_syncs : int
        Number of SYNCs of somebody else.
    talk : Frames
        What nodes and other masters say besides sums and SYNC, and the gateway's own commands.
    """

    bus: int
    rows: Bytes
    places: Integers
    tells_loss: bool
    echoes: int
    other_syncs: int
    talk: Frames


def batch_of(arrived: Frames, bus: int, table: FrameTable | PartTable) -> Batch:
    """Look through the frames that arrived on a bus; `table` has the frames with sums."""
    rows, places = frame_bytes(arrived), np.empty(len(arrived), np.int64)
    tells_loss, echoes, other_syncs, talk = sort(rows, bus, table, places)
    return Batch(bus, rows, places, tells_loss, echoes, other_syncs, arrived[talk] if talk else arrived[:0])


@njit(cache=True, nogil=True)
def sort(rows: Bytes, bus: int, table: FrameTable | PartTable, places: Integers) -> tuple[bool, int, int, list[int]]:
    """Look through frames as `batch_of`; `talk` is where the frames of that are."""
    (rows, places), table = borrowed((rows, places)), borrowed(table)
    tells_loss, echoes, other_syncs, talk = False, 0, 0, [0 for _ in range(0)]
    for place in range(rows.shape[0]):
        row = rows[place]
        can_id, flags = field(row, CAN_ID_AT, 4), row[FLAGS_AT]
        is_plain = flags & (EXTENDED | REMOTE) == 0
        is_command = can_id == NMT_COB_ID
        places[place] = NOTHING
        if can_id == SYNC_COB_ID and is_plain and not flags & ERROR:
            places[place] = OWN_SYNC if flags & ECHO else OTHER_SYNC
            other_syncs += places[place] == OTHER_SYNC
        elif flags & ECHO:
            echoes += is_command or can_id >= SDO_REQUEST_BASE
            if is_command and not flags & ERROR:
                talk.append(place)
        elif flags & ERROR:
            tells_loss |= can_id & _OFF != 0 or (can_id & _CONTROLLER != 0 and row[DATA_AT + 1] & _OVERFLOW != 0)
        else:
            places[place] = _place_of(row, can_id, bus, table)
            is_emergency = EMCY_BASE < can_id <= EMCY_BASE + HIGHEST_NODE_ID
            if is_plain and (is_command or is_emergency or can_id > SDO_RESPONSE_BASE):
                talk.append(place)
    return tells_loss, echoes, other_syncs, talk


@njit(cache=True, nogil=True)
def _place_of(row: Bytes, can_id: int, bus: int, table: FrameTable | PartTable) -> int:
    place = table.row_of[bus, can_id] if can_id <= BASE_ID_MASK else STRANGE
    if place < 0 or row[FLAGS_AT] & (EXTENDED | REMOTE | FD) != table.flags[place] & FD:
        return STRANGE
    if row[LENGTH_AT] != table.length[place] or not 1 <= row[DATA_AT] <= SYNC_OVERFLOW:
        return WRONG
    return int(place)
