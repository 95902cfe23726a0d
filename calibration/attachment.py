"""The calibration of the gateway as an attachment of a recording, again after each change."""

from collections.abc import Callable
from typing import Final

from canskin.calibration_messages import ZERO, CalibrationReply, CalibrationStatus, ZeroRequest
from canskin.errors import BusError
from canskin.fabric import Fabric, Mailbox
from canskin.messages import GATEWAY, GatewayStatus
from recording.mcap_file import CALIBRATION_FILE, File
from shell.service import StopSignal

#: Longest wait for an answer, shorter than `ANSWER_S`: the gateway tells its calibration within milliseconds, and who
#: stops the recorder waits as long.
_SHOW_S: Final = 2.0
#: Pause before a request that was not answered is repeated.
_AGAIN_S: Final = 1.0
#: Period of the check of the stop signal.
_TURN_S: Final = 0.1


def _mark(status: CalibrationStatus) -> tuple[object, ...]:
    return status.state, status.revision, status.tared_mono_ns, status.known_sums, *status.defects


def follow_calibration(
    fabric: Fabric, attach: Callable[[File], None], stop: StopSignal, turn: Callable[[], None] = lambda: None
) -> None:
    """Ask for the calibration after each change (zero, gains, defects, a start of the gateway) and attach it.

    `turn` is called each 0.1 s, except during a question.
    """
    statuses: Mailbox[GatewayStatus] = fabric.mailbox(GATEWAY, 1)
    seen: tuple[object, ...] = ()
    cycles = 0
    while not stop.is_set():
        turn()
        status = statuses.get(_TURN_S)
        if status is None or status.calibration is None:
            continue
        mark = _mark(status.calibration)
        is_known, cycles = mark == seen and status.cycles >= cycles, status.cycles  # a start counts cycles from 0
        if is_known:
            continue
        content = _shown(fabric)
        seen = mark if content else ()
        if content:
            attach(File(CALIBRATION_FILE, "application/json", content))
        else:
            stop.wait(_AGAIN_S)


def _shown(fabric: Fabric) -> bytes:
    """Return the calibration as a file; nothing if the gateway is busy, has ended, or is a replay."""
    try:
        reply: CalibrationReply = fabric.ask(ZERO, ZeroRequest(), _SHOW_S)
    except BusError:
        return b""
    return reply.content
