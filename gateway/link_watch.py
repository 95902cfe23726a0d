"""The faults of the link to one bus: each is told once, with its cause, and once more when it is over."""

from collections.abc import Callable
from typing import Final

from bus.link import State
from canskin.messages import LINK_CODES, REFUSED_CODE

#: A fault is over when the link has worked for this long: a controller between two states is one fault. The reason of a
#: lost interface is told when it has stood for this long.
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
        The worst between the last two reports; that of the fault for as long as `trouble` tells the fault.
    trouble : str
        The fault of now, in words that follow the name of the bus; empty without.
    """

    def __init__(self, name: str, say: Callable[[str], None]) -> None:
        self.state = self._worst = State.ACTIVE
        self.trouble = ""
        self._name, self._say = name, say
        self._refused = self._refused_in_all = 0
        #: The fault of now, by severity: a state, `WARNING` for SYNCs that were refused, `ACTIVE` for none.
        self._fault = State.ACTIVE
        self._since_s = self._seen_s = self._words_s = 0.0
        #: The newest fault in the log, and its words.
        self._told, self._told_words = State.ACTIVE, ""

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
        self._refused_in_all += refused
        fault = self.state if self.state in _FAULTS else State.WARNING if refused else State.ACTIVE
        if fault is not State.ACTIVE and self._fault is State.ACTIVE:
            self._since_s = now_s
        is_over = now_s - self._seen_s >= CALM_S
        if fault is not State.ACTIVE and (fault >= self._fault or is_over):
            self._seen_s = now_s
            self._go_on(fault, explain(), now_s)
        elif self._fault is not State.ACTIVE:
            explain()  # some controllers report no better state: it is read
            if is_over:
                self._end()
            elif self._fault in _FAULTS:
                self.state = self._fault

    def _go_on(self, fault: State, why: str, now_s: float) -> None:
        words = f"{_FAULTS[fault]}{': ' * bool(why)}{why}" if fault in _FAULTS else f"{_REFUSED}: {why or _LATE}"
        if not why and fault is self._fault:
            words = self.trouble  # the fault is just over
        if words != self.trouble:
            self._words_s = now_s
        # An interface that goes has another reason in its first moments; and one that comes back may be wrong.
        is_lost = fault is State.LOST
        is_steady = not is_lost or now_s - self._words_s >= CALM_S
        if is_steady and (fault is not self._told or (is_lost and words != self._told_words)):
            self._tell(fault, words)
        self._fault, self.trouble = fault, words

    def _tell(self, fault: State, words: str) -> None:
        self._told, self._told_words = fault, words
        code = LINK_CODES.get(fault.name.lower(), REFUSED_CODE)
        self._say(f"{self._name} {words} [{code}]")

    def _end(self) -> None:
        if self._told is not self._fault:
            self._tell(self._fault, self.trouble)
        syncs = f", {self._refused_in_all} SYNCs were not sent" if self._refused_in_all else ""
        self._say(f"{self._name} works again, after {self._seen_s - self._since_s:.1f} s{syncs}")
        self._fault, self._told, self.trouble, self._refused_in_all = State.ACTIVE, State.ACTIVE, "", 0
