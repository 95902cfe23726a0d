"""Who is on a bus, and what has happened there."""

from dataclasses import dataclass, field

from bus.controller import Controller
from bus.error_frames import State


@dataclass(slots=True, eq=False)
class Station:
    """One connection to the bus and its controllers by port; without any it listens and does not acknowledge.

    Attributes
    ----------
    state : State
        The worst state of its controllers.
    off : bool
        Whether every controller is without power, so that nothing is received either.
    """

    number: int
    name: str
    queue_size: int
    controllers: dict[int, Controller] = field(default_factory=dict)
    state: State = State.ACTIVE
    off: bool = False

    def refresh(self) -> None:
        """Derive `state` and `off` anew, after a controller came or changed."""
        self.state = max((one.state for one in self.controllers.values()), default=State.ACTIVE)
        self.off = bool(self.controllers) and all(one.off for one in self.controllers.values())


@dataclass(slots=True)
class Counts:
    """What happened since the bus began.

    ``accepted == transmitted + discarded + waiting``; receivers got ``transmitted - lost + duplicated``.
    """

    accepted: int = 0
    transmitted: int = 0
    discarded: int = 0
    lost: int = 0
    duplicated: int = 0
    delayed: int = 0
    errors: int = 0
    busy_ns: int = 0
