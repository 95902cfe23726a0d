"""The stations of a bus, and its counters."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import count

from bus.controller import Controller
from bus.error_frames import State


@dataclass(slots=True, eq=False)
class Station:
    """One connection to the bus and its controllers by port.

    Attributes
    ----------
    state : State
        Most severe state of its controllers.
    off : bool
        Whether all controllers have no power; the station then receives nothing.
    idle : list of int
        Ports of the controllers that take no part in the bus.
    """

    number: int
    name: str
    queue_size: int
    controllers: dict[int, Controller] = field(default_factory=dict)
    state: State = State.ACTIVE
    off: bool = False
    idle: list[int] = field(default_factory=list)

    def refresh(self) -> None:
        """Compute `state`, `off` and `idle` again, after a controller came or changed."""
        self.idle = [port for port, one in self.controllers.items() if not one.takes_part]
        self.state = max(one.state for one in self.controllers.values())
        self.off = all(one.off for one in self.controllers.values())


class Stations:
    """All stations of a bus.

    Attributes
    ----------
    by_number : dict of int to Station
    takers : int
        Number of controllers that take part; a frame needs its sender and another controller that acknowledges.
    """

    def __init__(self) -> None:
        self.by_number: dict[int, Station] = {}
        self.takers = 0
        self._numbers = count()

    def add(self, name: str, queue_size: int) -> Station:
        """Add a station without controllers."""
        station = Station(next(self._numbers), name, queue_size)
        self.by_number[station.number] = station
        return station

    def remove(self, station: Station) -> None:
        """Let a station go."""
        del self.by_number[station.number]

    def controllers(self) -> Iterator[Controller]:
        """Yield the controllers of all stations."""
        return (controller for station in self.by_number.values() for controller in station.controllers.values())

    def refresh(self) -> None:
        """Compute `takers` and each station's state again, after a controller came, went or changed."""
        self.takers = sum(controller.takes_part for controller in self.controllers())
        for station in self.by_number.values():
            station.refresh()


@dataclass(slots=True)
class Counts:
    """Counters since the start of the bus.

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
