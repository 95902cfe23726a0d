"""One CAN controller: its error counters and its state (ISO 11898-1, fault confinement)."""

from dataclasses import dataclass

from bus.error_frames import State


@dataclass(slots=True, eq=False)
class Controller:
    """A transmit queue and two error counters.

    Attributes
    ----------
    name : str
        ``STATION:PORT``; faults select controllers by this name.
    station, port : int
        Number of its connection, and its number on this connection.
    off : bool
        No power: the controller neither sends nor acknowledges.
    suspended_until_ns : int
        End of suspend transmission: an error-passive transmitter waits eight more bits.
    restart_ns, recover_ns : int
        End of the restart delay, and end of bus-off after 128 x 11 recessive bits more.
    """

    name: str
    station: int
    port: int
    transmit_errors: int = 0
    receive_errors: int = 0
    off: bool = False
    state: State = State.ACTIVE
    suspended_until_ns: int = 0
    restart_ns: int = 0
    recover_ns: int = 0

    @property
    def takes_part(self) -> bool:
        """Whether the controller acknowledges and may send."""
        return not self.off and self.state is not State.BUS_OFF

    @property
    def disturbed(self) -> bool:
        """Whether an error counter is above 0."""
        return self.transmit_errors > 0 or self.receive_errors > 0

    def transmit_failed(self, *, unacknowledged: bool) -> None:
        """Count an error of a sent frame; a passive controller does not count a missing acknowledgement."""
        if not (unacknowledged and self.state is State.PASSIVE):
            self.transmit_errors += 8

    def receive_failed(self) -> None:
        """Count an error of a received frame."""
        self.receive_errors = min(self.receive_errors + 1, 255)

    def transmitted(self) -> None:
        """Count a sent frame."""
        self.transmit_errors = max(self.transmit_errors - 1, 0)

    def received(self) -> None:
        """Count a received frame; the counter of a passive receiver is set to 119 (the standard allows 119 to 127)."""
        self.receive_errors = 119 if self.receive_errors > 127 else max(self.receive_errors - 1, 0)

    def reset(self) -> None:
        """Leave bus-off as a new, error-active controller."""
        self.transmit_errors = self.receive_errors = 0
        self.state = State.ACTIVE

    def judge(self) -> bool:
        """Compute the state from the counters; return whether it changed."""
        worst = max(self.transmit_errors, self.receive_errors)
        if self.transmit_errors > 255:
            state = State.BUS_OFF
        elif worst > 127:
            state = State.PASSIVE
        else:
            state = State.WARNING if worst >= 96 else State.ACTIVE
        changed = state is not self.state
        self.state = state
        return changed
