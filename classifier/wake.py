"""Asks for images when something touches a skin that recognises first."""

import threading
import time
from collections.abc import Callable
from typing import Final

from canskin.messages import UNKNOWN_OBJECT
from shell.service import say
from skin.layout import Recognition

#: A request is renewed after this part of its time.
RENEW: Final = 0.5


class Wake:
    """Asks for images as ``recognition.wake`` of the layout says, from a thread of its own.

    Parameters
    ----------
    ask : callable
        Asks the gateway for images, for a time in seconds; may block. Errors are logged once until a request works.
    clock : callable, optional
        Monotonic time in seconds.
    """

    def __init__(
        self, state: Recognition, ask: Callable[[float], object], clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._state, self._ask, self._clock = state, ask, clock
        self._due_s = float("-inf")
        self._wanted = threading.Event()
        self._is_closed = False
        self._thread = threading.Thread(target=self._serve, name="wake", daemon=True)
        self._thread.start()

    def take(self, label: str) -> None:
        """Take a label, empty without contact; ask for images if it is time to."""
        now_s = self._clock()
        if self.wants(label, now_s):
            self._due_s = now_s + RENEW * self._state.hold_s
            self._wanted.set()

    def wants(self, label: str, now_s: float) -> bool:
        """Tell whether a label that comes now is to ask for images."""
        wakes = {"contact": bool(label), "label": label not in ("", UNKNOWN_OBJECT), "request": False}
        return wakes[self._state.wake] and now_s >= self._due_s

    def close(self) -> None:
        """End the thread."""
        self._is_closed = True
        self._wanted.set()
        self._thread.join()

    def _serve(self) -> None:
        is_told = False
        while self._wanted.wait() and not self._is_closed:
            self._wanted.clear()
            try:
                self._ask(self._state.hold_s)
                is_told = False
            except Exception as error:  # noqa: BLE001 - whatever happened, the next label asks again
                if not is_told:
                    say("classifier", f"no images: {error}")
                is_told = True
                self._due_s = float("-inf")
