"""The calibration of the gateway as an attachment of a recording, again after each change."""

import threading
from collections.abc import Callable
from typing import Final

from canskin.calibration_messages import CALIBRATION, CalibrationReply, CalibrationRequest, CalibrationStatus
from canskin.errors import BusError
from canskin.fabric import Fabric
from canskin.messages import GATEWAY, GatewayStatus
from skin.mcap_file import CALIBRATION_FILE, File
from skin.service import StopSignal

#: Longest wait for an answer; the gateway tells its calibration within milliseconds.
ANSWER_S: Final = 2.0
#: The stop signal is looked at so often.
_TURN_S: Final = 0.1


class Changes:
    """Notices when the calibration in the status of the gateway is another: a new zero, other defects, a start."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._seen: tuple[object, ...] = ()
        self._is_new = False

    def take(self, status: GatewayStatus) -> None:
        """Take a status; from any thread."""
        known = status.calibration
        if known is None:
            return
        with self._lock:
            self._is_new |= (mark := _mark(known)) != self._seen
            self._seen = mark

    def pop(self) -> bool:
        """Tell whether there was a change since the last call."""
        with self._lock:
            was_new, self._is_new = self._is_new, False
        return was_new


def _mark(status: CalibrationStatus) -> tuple[object, ...]:
    return status.state, status.tared_mono_ns, status.known_sums, *status.defects


def follow_calibration(fabric: Fabric, attach: Callable[[File], None], stop: StopSignal) -> None:
    """Ask for the calibration after each change, and attach it, until `stop`."""
    changes = Changes()
    fabric.subscribe(GATEWAY, changes.take)
    while not stop.wait(_TURN_S):
        if not changes.pop():
            continue
        try:
            reply: CalibrationReply = fabric.ask(CALIBRATION, CalibrationRequest(action="show"), ANSWER_S)
        except BusError:  # a gateway that ends, or a replay: the next change asks again
            continue
        if reply.content:
            attach(File(CALIBRATION_FILE, "application/json", reply.content))
