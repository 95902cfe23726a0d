"""Emergency objects (CiA 301, 7.2.7): sent once when an error occurs and once when the error is gone."""

import struct
from collections import deque
from collections.abc import Callable
from typing import Final

from dbc.canopen import Emergency, ErrorRegister
from dbc.dictionary import ERRORS_KEPT

EMCY: Final = struct.Struct("<HB5s")  # error code, error register, manufacturer's field

_REGISTER: Final = {
    Emergency.HEARTBEAT_LOST: ErrorRegister.COMMUNICATION,
    Emergency.SYNC_LENGTH: ErrorRegister.COMMUNICATION,
    Emergency.WINDOW_MISSED: ErrorRegister.MANUFACTURER,
}


class EmcyProducer:
    """Errors of one node.

    Parameters
    ----------
    send : callable
        Sends the eight bytes; called at most once per inhibit time.
    """

    def __init__(self, send: Callable[[bytes], None]) -> None:
        self._send = send
        self._active: set[Emergency] = set()
        self._history: deque[int] = deque(maxlen=ERRORS_KEPT)
        self._waiting: deque[bytes] = deque(maxlen=ERRORS_KEPT)
        self._free_at_s = 0.0

    @property
    def register(self) -> int:
        """Error register (1001h): the bits of all active errors, with the generic bit."""
        bits = ErrorRegister.GENERIC if self._active else 0
        for error in self._active:
            bits |= _REGISTER[error]
        return bits

    @property
    def history(self) -> list[int]:
        """Pre-defined error field (1003h), newest first: error code in bits 0 to 15, additional information above."""
        return list(self._history)

    @property
    def is_waiting(self) -> bool:
        """Whether messages wait to be sent."""
        return bool(self._waiting)

    def clear_history(self) -> None:
        """Clear the error field (write 0 to 1003h sub 0)."""
        self._history.clear()

    def reset(self) -> None:
        """Clear active errors, error field and waiting messages, as a reset does."""
        self._active.clear()
        self._history.clear()
        self._waiting.clear()

    def raised(self, error: Emergency, field: int = 0) -> None:
        """Report an error, unless it is active already; `field` fills the manufacturer's bytes."""
        if error in self._active:
            return
        self._active.add(error)
        self._history.appendleft((field & 0xFFFF) << 16 | error)
        self._waiting.append(EMCY.pack(error, self.register, (field & 0xFF_FFFF_FFFF).to_bytes(5, "little")))

    def gone(self, error: Emergency) -> None:
        """Report that an active error is gone."""
        if error in self._active:
            self._active.discard(error)
            self._waiting.append(EMCY.pack(Emergency.NONE, self.register, error.to_bytes(5, "little")))

    def flush(self, now_s: float, inhibit_s: float) -> None:
        """Send waiting messages, one per inhibit time."""
        while self._waiting and now_s >= self._free_at_s:
            self._send(self._waiting.popleft())
            self._free_at_s = now_s + inhibit_s
