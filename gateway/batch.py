"""A batch of received frames, looked through once: what each part of the gateway needs of it besides the sums."""

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from bus.error_frames import ErrorClass
from dbc.canopen import EMCY_BASE, HIGHEST_NODE_ID, NMT_COB_ID, SDO_REQUEST_BASE, SDO_RESPONSE_BASE
from dbc.frame import CAN_ID_AT, DATA_AT, ECHO, ERROR, EXTENDED, FLAGS_AT, REMOTE, Frames, frame_bytes
from dbc.frame_fields import field
from shell.compiled import njit

#: Byte 1 of a report of the controller: its receive buffer has overflowed (SocketCAN: CAN_ERR_CRTL_RX_OVERFLOW).
_OVERFLOW: Final = 0x01
#: Plain numbers for compiled code.
_OFF: Final = int(ErrorClass.BUS_OFF | ErrorClass.RESTARTED)
_CONTROLLER: Final = int(ErrorClass.CONTROLLER)


class Batch(NamedTuple):
    """Frames of a bus, in bus order.

    Attributes
    ----------
    frames : Frames
    tells_loss : bool
        A report of the controller among them says that it received nothing for a time.
    echoes : int
        Number of the gateway's own commands and SDO requests, which were on the bus.
    talk : Frames
        What nodes and other masters say besides sums and SYNC, and the gateway's own commands.
    """

    frames: Frames
    tells_loss: bool
    echoes: int
    talk: Frames


def batch_of(arrived: Frames) -> Batch:
    """Look through the frames that arrived on a bus."""
    tells_loss, echoes, talk = _sort(frame_bytes(arrived))
    return Batch(arrived, tells_loss, echoes, arrived[talk] if talk else arrived[:0])


@njit(cache=True, nogil=True)
def _sort(rows: npt.NDArray[np.uint8]) -> tuple[bool, int, list[int]]:
    tells_loss, echoes, talk = False, 0, [0 for _ in range(0)]
    for place in range(rows.shape[0]):
        row = rows[place]
        can_id, flags = field(row, CAN_ID_AT, 4), row[FLAGS_AT]
        is_command = can_id == NMT_COB_ID
        if flags & ECHO:
            echoes += is_command or can_id >= SDO_REQUEST_BASE
            if is_command and not flags & ERROR:
                talk.append(place)
        elif flags & ERROR:
            tells_loss |= can_id & _OFF != 0 or (can_id & _CONTROLLER != 0 and row[DATA_AT + 1] & _OVERFLOW != 0)
        elif flags & (EXTENDED | REMOTE) == 0:
            is_emergency = EMCY_BASE < can_id <= EMCY_BASE + HIGHEST_NODE_ID
            if is_command or is_emergency or can_id > SDO_RESPONSE_BASE:
                talk.append(place)
    return tells_loss, echoes, talk
