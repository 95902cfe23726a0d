"""The faults of the link to one bus: each is told once, with its cause, and once more when it is over."""

from collections.abc import Callable
from typing import Final

from bus.link import State

#: A fault is over when the link has worked for this long: a controller between two states is one fault.
CALM_S: Final = 1.0
#: Faults by the state of the controller. From others it takes no SYNC, or all is well.
_FAULTS: Final = {
    State.PASSIVE: "troubled: the gateway's controller is error passive: are nodes powered and wired?",
    State.BUS_OFF: "dead: the gateway's controller is bus-off: wiring, termination or bit rate",
    State.LOST: "dead: the gateway has lost its interface",
}
_REFUSED: Final = "without SYNC"
_LATE: Final = "the gateway comes too late for it: is its machine overloaded?"


class LinkWatch:
    """Watches the link of one bus.

    Parameters
    ----------
    name : str
        Of the bus.
    say : callable
        Writes a line to the log.

    Attributes
    ----------
    state : State
        The worst between the last two reports.
    trouble : str
        The fault of now, in words that follow the name of the bus; empty without.
    """

    def __init__(self, name: str, say: Callable[[str], None]) -> None:
        self.state = self._worst = State.ACTIVE
        self.trouble = ""
        self._name, self._say = name, say
        self._refused = self._refused_in_all = 0
        #: The fault that was told, by severity: a state, `WARNING` for SYNCs that were refused, `ACTIVE` for none.
        self._told = State.ACTIVE
        self._since_s = self._seen_s = 0.0

    def look(self, state: State) -> None:
        """Use the state of the controller after each look at the link."""
        self._worst = max(self._worst, state)

    def count_sync(self, *, is_taken: bool) -> None:
        """Use what the link did with a SYNC."""
        self._refused += not is_taken

    def report(self, explain: Callable[[], str], now_s: float) -> None:
        """Tell a new fault, or the end of a fault; call it some times a second.

        Parameters
        ----------
        explain : callable
            See `bus.link.Link.explain`; called while there is a fault.
        """
        self.state, self._worst = self._worst, State.ACTIVE
        refused, self._refused = self._refused, 0
        fault = self.state if self.state in _FAULTS else State.WARNING if refused else State.ACTIVE
        self._refused_in_all += refused
        if fault is not State.ACTIVE and fault >= self._told:
            self._seen_s = now_s
        words = ""
        if fault is not State.ACTIVE:
            why = explain()
            words = f"{_FAULTS[fault]}{': ' * bool(why)}{why}" if fault in _FAULTS else f"{_REFUSED}: {why or _LATE}"
        is_worse = fault > self._told
        is_over = self._told is not State.ACTIVE and now_s - self._seen_s >= CALM_S
        if is_worse and self._told is State.ACTIVE:
            self._since_s = now_s
        if is_worse or (is_over and words):
            self._say(f"{self._name} {words}")
        elif is_over:
            syncs = f", {self._refused_in_all} SYNCs were not sent" if self._refused_in_all else ""
            self._say(f"{self._name} works again, after {self._seen_s - self._since_s:.1f} s{syncs}")
            self._refused_in_all = 0
        if is_worse or is_over:
            self._told, self._seen_s = fault, now_s
        if fault is self._told:
            self.trouble = words
