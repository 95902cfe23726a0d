"""Reports of a controller's errors, as FRAME records with the data of SocketCAN's error frames.

Layout: Linux ``include/uapi/linux/can/error.h``. ``can_id`` holds the error class without CAN_ERR_FLAG, because FRAME
has the flag ERROR. Byte 1 is the state of the controller, bytes 2 and 3 are type and position of a protocol violation,
bytes 6 and 7 the transmit and receive error counters.
"""

from enum import IntEnum, IntFlag
from typing import Final

import numpy as np

from dbc.frame import ERROR, Frames, frames


class ErrorClass(IntFlag):
    """Error class, in `can_id` of the record."""

    CONTROLLER = 0x004
    PROTOCOL = 0x008
    ACK = 0x020
    BUS_OFF = 0x040
    BUS_ERROR = 0x080
    RESTARTED = 0x100
    COUNTERS = 0x200


class State(IntEnum):
    """State of a controller, in ascending order of severity."""

    ACTIVE = 0
    WARNING = 1
    PASSIVE = 2
    BUS_OFF = 3
    #: Not a state of CAN: the process of the bus, or the interface, is gone.
    LOST = 4


#: Byte 1: receive or transmit counter at 96 or more, above 127, or back below.
_WARNING: Final = {"receive": 0x04, "transmit": 0x08}
_PASSIVE: Final = {"receive": 0x10, "transmit": 0x20}
_ACTIVE: Final = 0x40
#: Byte 2: a bit error, seen while transmitting. Byte 3: in the ACK slot.
_PROTOCOL_TRANSMIT: Final = 0x80
_PROTOCOL_BIT: Final = 0x01
_LOCATION_ACK: Final = 0x19


def state_report(state: State, transmit_errors: int, receive_errors: int, *, restarted: bool = False) -> Frames:
    """Return the report of a controller that changed to `state`, one record."""
    counters = ErrorClass.COUNTERS
    if state is State.BUS_OFF:
        return _report(ErrorClass.BUS_OFF | counters, (0, 0, 0), transmit_errors, receive_errors)
    side = "transmit" if transmit_errors >= receive_errors else "receive"
    control = {State.WARNING: _WARNING[side], State.PASSIVE: _PASSIVE[side]}.get(state, _ACTIVE)
    why = ErrorClass.CONTROLLER | counters | (ErrorClass.RESTARTED if restarted else ErrorClass(0))
    return _report(why, (control, 0, 0), transmit_errors, receive_errors)


def ack_report(transmit_errors: int, receive_errors: int) -> Frames:
    """Return the report of a frame that nobody acknowledged."""
    why = ErrorClass.ACK | ErrorClass.BUS_ERROR | ErrorClass.COUNTERS
    return _report(why, (0, _PROTOCOL_TRANSMIT, _LOCATION_ACK), transmit_errors, receive_errors)


def bit_report(transmit_errors: int, receive_errors: int) -> Frames:
    """Return the report of a bit error: the transmitter read back another bit than it sent."""
    why = ErrorClass.PROTOCOL | ErrorClass.BUS_ERROR | ErrorClass.COUNTERS
    return _report(why, (0, _PROTOCOL_TRANSMIT | _PROTOCOL_BIT, 0), transmit_errors, receive_errors)


def _report(why: ErrorClass, detail: tuple[int, int, int], transmit_errors: int, receive_errors: int) -> Frames:
    one = frames(1)
    one["can_id"], one["flags"], one["length"] = why, ERROR, 8
    one["data"][0, 1:4] = detail
    one["data"][0, 6:8] = min(transmit_errors, 255), min(receive_errors, 255)
    return one


def state_of_report(report: np.void, before: State) -> State:
    """Return the state of a controller after a report, `before` if the report contains no state."""
    why, control = int(report["can_id"]), int(report["data"][1])
    if why & ErrorClass.BUS_OFF:
        return State.BUS_OFF
    if why & ErrorClass.RESTARTED:
        return State.ACTIVE
    if why & ErrorClass.CONTROLLER:
        if control & sum(_PASSIVE.values()):
            return State.PASSIVE
        if control & sum(_WARNING.values()):
            return State.WARNING
        if control & _ACTIVE:
            return State.ACTIVE
    return before
