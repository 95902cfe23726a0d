"""What the loop tells every gathering of sums: the SYNC that is to be sent, and whether a bus may have lost frames."""

from dataclasses import dataclass
from typing import Final

from bus.link import State

_DOWN: Final = (State.BUS_OFF, State.LOST)


@dataclass(frozen=True)
class Sync:
    """A SYNC that is about to be sent.

    Attributes
    ----------
    number, counter : int
        Number since the start, and counter byte.
    due_ns : int
        When it was due.
    sent_ns : int or None
        A time just before it is sent; None in a replay.
    wall_offset_ns : int
        Wall clock minus monotonic clock.
    """

    number: int
    counter: int
    due_ns: int
    sent_ns: int | None
    wall_offset_ns: int

    @property
    def due_s(self) -> float:
        """When it was due, seconds."""
        return self.due_ns * 1e-9


class Health:
    """Whether a bus may have lost frames since the last look.

    Attributes
    ----------
    has_gap : bool
        Frames were lost before or among the newest that arrived.
    is_down : bool
        The controller is off the bus.
    has_returned : bool
        The controller is back on the bus.
    stamp_error_ns : int or None
        Of the newest frames: bound of the error of the clock of their time stamps, None if they have none.
    """

    def __init__(self) -> None:
        self.has_gap = self.is_down = self.has_returned = False
        self.stamp_error_ns: int | None = None
        self._dropped = 0

    def look(self, state: State, dropped: int, stamp_error_ns: int | None, *, tells_loss: bool) -> None:
        """Use what a link says after it was read.

        Parameters
        ----------
        state : State
            Of the controller.
        dropped : int
            Frames that the receive side has lost so far.
        stamp_error_ns : int or None
            See `bus.link.Link`.
        tells_loss : bool
            See `gateway.batch.Batch`.
        """
        self.stamp_error_ns = stamp_error_ns
        is_down = state in _DOWN
        self.has_returned = self.is_down and not is_down
        self.has_gap = is_down or self.is_down or dropped != self._dropped or tells_loss
        self.is_down, self._dropped = is_down, dropped
