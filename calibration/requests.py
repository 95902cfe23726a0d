"""What programs ask of the calibration of a running skin, and those that wait for a zero."""

from collections import deque
from typing import Final, NamedTuple

from calibration.calibrator import Calibrator
from canskin.calibration_messages import CalibrationReply, CalibrationRequest, Region, ZeroRequest, tare_request
from canskin.errors import InputError
from canskin.fabric import Reply
from skin.calibration_file import StoredCalibration, parse_calibration
from skin.layout import Layout
from skin.regions import taxels_of

#: A measurement of the zero that takes longer is answered with the reason; the measurement goes on.
PATIENCE_S: Final = 8.0
#: Requests that wait for an answer; more are refused.
MOST_REQUESTS: Final = 8
#: Longest content of a request: bytes for each sum and taxel, and for all else.
_NUMBER_BYTES: Final = 32
_OTHER_BYTES: Final = 1 << 16
_TOO_FEW: Final = "fewer than half of the sums are valid: the zero is measured when they are"


class Request(NamedTuple):
    """A request, who waits for its answer, and the calibration in it, if it has one."""

    request: CalibrationRequest | ZeroRequest
    reply: Reply
    stored: StoredCalibration | None


class Ended(NamedTuple):
    """A measurement of the zero that has ended, or that has taken too long.

    Attributes
    ----------
    is_done : bool
        Whether there is a new zero.
    text : str
        The result in words.
    region : tuple of int, or str, optional
        Of the request.
    replies : list of Reply
        Those who wait for the answer.
    """

    is_done: bool
    text: str
    region: Region | str | None
    replies: list[Reply]


class Requests:
    """Requests in the order in which they came."""

    def __init__(self, layout: Layout, calibrator: Calibrator) -> None:
        self._layout, self._calibrator = layout, calibrator
        self._waiting: deque[Request] = deque()
        self._taring: list[Reply] = []
        self._wanted = CalibrationRequest(action="tare")
        self._until_s = 0.0

    def ask(self, request: CalibrationRequest | ZeroRequest, reply: Reply) -> None:
        """Take a request; from any thread. What cannot be used is refused here."""
        try:
            self._waiting.append(Request(request, reply, self._checked(request)))
        except InputError as error:
            reply(CalibrationReply(is_done=False, text=str(error)))

    def next(self) -> Request | None:
        """Return the request that has waited longest; None without any."""
        return self._waiting.popleft() if self._waiting else None

    def tare(self, request: CalibrationRequest, reply: Reply, now_s: float) -> None:
        """Begin to measure the zero; raise InputError while another zero is wanted."""
        if self._taring and request != self._wanted:
            raise InputError("another tare is under way: ask again when it has ended")
        self._calibrator.tare(force=request.force, region=request.region)
        self._taring.append(reply)
        self._wanted, self._until_s = request, now_s + PATIENCE_S

    def ended(self, now_s: float) -> Ended | None:
        """Return the measurement of the zero that was asked for, when it has ended or has taken too long."""
        result = self._calibrator.result
        if not self._taring or (result is None and now_s <= self._until_s):
            return None
        replies, self._taring = self._taring, []
        text = self._why_late() if result is None else result.text
        return Ended(result is not None and result.is_done, text, self._wanted.region, replies)

    def _why_late(self) -> str:
        """Say why there is no zero yet."""
        takes_s = self._calibrator.tare_s
        if self._calibrator.has_few_sums and takes_s <= PATIENCE_S:
            return _TOO_FEW
        return f"the zero is still being measured, which takes {takes_s:.3g} s: see 'skin calibration show'"

    def _checked(self, request: CalibrationRequest | ZeroRequest) -> StoredCalibration | None:
        """Return the calibration in a request."""
        if len(self._waiting) + len(self._taring) >= MOST_REQUESTS:
            raise InputError(f"{MOST_REQUESTS} requests wait for an answer: ask again later")
        if isinstance(request, ZeroRequest):
            return None
        layout = self._layout
        if request.action == "tare":
            tare_request(layout.taxels.rows, layout.taxels.columns, force=request.force, region=request.region)
            if request.region is not None:
                taxels_of(layout, request.region)
        if request.action not in {"load", "write"}:
            return None
        most = _NUMBER_BYTES * (layout.phi().shape[0] + 2 * layout.taxels.count) + _OTHER_BYTES
        if len(request.content) > most:
            raise InputError(f"a calibration of {len(request.content)} bytes: expected {most} at most for this skin")
        return parse_calibration(request.content, layout, "calibration")
