"""Switches all nodes between recognition and images, by one RPDO that acts at the next SYNC (CiA 301, 7.2.2.3).

The gateway asks for the other state with the first SYNC after the RPDO has been on every bus. A node that missed it, or
was reset, follows when the RPDO is sent again.
"""

from collections import deque
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from bus.link import Send
from canskin.messages import Measurement
from dbc.canopen import STATE_COB_ID
from dbc.contract import Contract
from dbc.dictionary import SkinState
from dbc.frame import ECHO, ERROR, Frames, one_frame

#: SYNCs after a switch at which the RPDO is sent again; then it is sent once in `REPEAT_S`.
REPEATS: Final = 3
REPEAT_S: Final = 0.25
#: Most SYNCs for which the gateway waits for the RPDO on every bus: a bus may be dead.
PATIENCE_SYNCS: Final = 3
#: Least time from a switch to the next SYNC, periods of recognition; a later switch begins after this SYNC. So nodes
#: and gateway change at one SYNC.
MARGIN: Final = 0.25


class StateSwitch:
    """The state of all nodes. Images come while they were asked for; otherwise the nodes recognise.

    Parameters
    ----------
    contract : Contract
        With recognition.
    sends : mapping of int to callable
        Sends frames, by number of the bus.

    Attributes
    ----------
    state : int
        `dbc.dictionary.SkinState`: that of the newest SYNC.
    switches : int
        Number of times images were asked for in recognition, and came before the request had ended.
    switch_s : float
        The newest time from such a request to the first complete image cycle, 0 before.
    """

    def __init__(self, contract: Contract, sends: Mapping[int, Send]) -> None:
        images, few = contract.states
        self.state = self._commanded = SkinState.RECOGNITION
        self.switches, self.switch_s = 0, 0.0
        self._periods_s = {
            SkinState.IMAGES: images.layout.sync.period_s,
            SkinState.RECOGNITION: few.layout.sync.period_s,
        }
        self._phi = contract.phi
        self._sends = dict(sends)
        self._requests: deque[tuple[float, bool]] = deque()
        self._until_s = self._send_s = float("-inf")
        self._asked_s: float | None = None
        #: Buses that have had the RPDO; SYNCs for which it was waited; SYNCs at which it is sent again.
        self._echoed: set[int] = set()
        self._waited = self._again = 0

    def ask_images(self, hold_s: float, *, is_counted: bool = True) -> None:
        """Ask for images from now on, for `hold_s` seconds; from any thread. An earlier request may last longer.

        Parameters
        ----------
        is_counted : bool
            False for what is not part of `switches` and `switch_s`.
        """
        self._requests.append((hold_s, is_counted))

    def tick(self, now_s: float, sync_due_s: float) -> None:
        """Send the RPDO if the state is to change, or if its time has come.

        A change does not begin just before the SYNC that is due at `sync_due_s`.
        """
        while self._requests:
            hold_s, is_counted = self._requests.popleft()
            self._until_s = max(self._until_s, now_s + hold_s)
            if is_counted and self._commanded == SkinState.RECOGNITION and self._asked_s is None:
                self._asked_s = now_s
        wanted = SkinState.IMAGES if now_s < self._until_s else SkinState.RECOGNITION
        if wanted == SkinState.RECOGNITION:
            self._asked_s = None
        if wanted != self._commanded and sync_due_s - now_s >= MARGIN * self._periods_s[SkinState.RECOGNITION]:
            self._commanded, self._again, self._waited = wanted, REPEATS, 0
            self._echoed.clear()
            self._send_s = now_s
        if now_s >= self._send_s:
            self._send_s = now_s + REPEAT_S
            for send in self._sends.values():
                send(one_frame(STATE_COB_ID, bytes((self._commanded,))))

    def take(self, bus: int, arrived: Frames) -> None:
        """Look for the gateway's own RPDO among the frames of a bus."""
        own = (arrived["can_id"] == STATE_COB_ID) & (arrived["flags"] & (ECHO | ERROR) == ECHO)
        if own.any() and np.any(arrived["data"][own, 0] == self._commanded):
            self._echoed.add(bus)

    def follow(self, bus: int, state: SkinState) -> None:
        """Take note of a recorded RPDO on a bus: the gateway of the run has asked for this state."""
        if state != self._commanded:
            self._commanded, self._waited = state, 0
            self._echoed.clear()
        self._echoed.add(bus)

    def begin_in(self, state: SkinState) -> None:
        """Take the state of a recording that begins in it."""
        self.state = self._commanded = state

    @property
    def _next_state(self) -> SkinState:
        """The state with the next SYNC."""
        follows = self._waited >= PATIENCE_SYNCS or self._echoed >= self._sends.keys()
        return self._commanded if follows else self.state

    @property
    def next_period_s(self) -> float:
        """Time from the next SYNC, if it is sent now, to the SYNC after it."""
        return self._periods_s[self._next_state]

    def take_sync(self, now_s: float) -> None:
        """Take note of a SYNC that is being sent, which sets `state`."""
        if self._commanded != self.state:
            self.state = self._next_state
            self._waited += 1
        if self._again:
            self._again -= 1
            self._send_s = now_s

    def status(self) -> dict[str, Any]:
        """Return the fields of `canskin.messages.GatewayStatus` that tell of the states."""
        state = "images" if self.state == SkinState.IMAGES else "recognition"
        return {"state": state, "switches": self.switches, "switch_s": self.switch_s}

    def take_measurement(self, measurement: Measurement, now_s: float) -> None:
        """Note how long a switch to images took."""
        if self._asked_s is None or measurement.fingerprint != self._phi.fingerprint:
            return
        if np.frombuffer(measurement.valid, np.bool_)[self._phi.has_sums].all():
            self.switches, self.switch_s = self.switches + 1, now_s - self._asked_s
            self._asked_s = None
