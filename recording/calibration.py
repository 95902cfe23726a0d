"""The calibration of the gateway as an attachment of a recording, again after each change."""

import threading
from collections.abc import Callable
from typing import Final

from canskin.calibration_messages import CALIBRATION, CalibrationReply, CalibrationRequest, CalibrationStatus
from canskin.errors import BusError
from canskin.fabric import Fabric
from canskin.messages import GATEWAY, GatewayStatus
from shell.service import StopSignal
from skin.mcap_file import CALIBRATION_FILE, File

#: Longest wait for an answer, shorter than `ANSWER_S`: the gateway tells its calibration within milliseconds, and who
#: stops the recorder waits as long.
_SHOW_S: Final = 2.0
#: Pause before a request that was not answered is repeated.
_AGAIN_S: Final = 1.0
#: Period of the check of the stop signal.
_TURN_S: Final = 0.1


class Changes:
    """Notices when the calibration of the gateway is another: new zero, gains, defects, or a start of the gateway."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._seen: tuple[object, ...] = ()
        self._cycles = 0
        self._is_new = False

    def take(self, status: GatewayStatus) -> None:
        """Take a status; from any thread."""
        known = status.calibration
        if known is None:
            return
        mark = _mark(known)
        with self._lock:
            self._is_new |= mark != self._seen or status.cycles < self._cycles  # a start counts cycles from 0
            self._seen, self._cycles = mark, status.cycles

    def pop(self) -> bool:
        """Tell whether there was a change since the last call."""
        with self._lock:
            was_new, self._is_new = self._is_new, False
        return was_new

    def put_back(self) -> None:
        """Have `pop` tell the last change again."""
        with self._lock:
            self._is_new = True


def _mark(status: CalibrationStatus) -> tuple[object, ...]:
    return status.state, status.revision, status.tared_mono_ns, status.known_sums, *status.defects


def follow_calibration(fabric: Fabric, attach: Callable[[File], None], stop: StopSignal) -> None:
    """Ask for the calibration after each change, and attach it, until `stop`."""
    changes = Changes()
    fabric.subscribe(GATEWAY, changes.take)
    while not stop.wait(_TURN_S):
        if not changes.pop():
            continue
        content = _shown(fabric)
        if content:
            attach(File(CALIBRATION_FILE, "application/json", content))
        else:
            changes.put_back()
            stop.wait(_AGAIN_S)


def _shown(fabric: Fabric) -> bytes:
    """Return the calibration as a file; nothing if the gateway is busy, has ended, or is a replay."""
    try:
        reply: CalibrationReply = fabric.ask(CALIBRATION, CalibrationRequest(action="show"), _SHOW_S)
    except BusError:
        return b""
    return reply.content
