"""The transmit queues of all controllers of a bus: frames from submission to the report to the sender."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from bus.arbitration import (
    DISCARDED,
    OWNER,
    PARKED_NS,
    QUEUED,
    Queued,
    carry,
    queued_frames,
    words,
)
from bus.controller import Controller
from bus.outbox import Outbox
from bus.station import Counts, Station
from dbc.frame import Frames


class Winner(NamedTuple):
    """The frame that wins an arbitration: its place among the queued frames, and its start."""

    place: int
    start_ns: int


class TransmitQueues:
    """Frames that wait for the bus, and reports that wait for collection.

    Attributes
    ----------
    queued : array of QUEUED
    """

    def __init__(self) -> None:
        self.queued: Queued = np.zeros(0, QUEUED)
        self.outbox = Outbox()
        self.counts = Counts()
        self._sequence = 0
        self._is_ascending = True

    # --- submission and return ---------------------------------------------------------------------------

    def waiting(self, station: Station) -> npt.NDArray[np.uint16]:
        """Return the ports of the waiting frames of a station."""
        ports: npt.NDArray[np.uint16] = self.queued["frame"]["port"][self.queued["station"] == station.number]
        return ports

    def fitting(self, station: Station, burst: Frames) -> int:
        """Count the leading frames that fit their transmit queues."""
        waiting = self.waiting(station)
        if len(waiting) + len(burst) <= station.queue_size:
            return len(burst)
        counts = np.bincount(waiting, minlength=1 << 16)
        for place, port in enumerate(burst["port"].tolist()):
            if counts[port] >= station.queue_size:
                return place
            counts[port] += 1
        return len(burst)

    def submit(self, burst: Frames, station: Station, durations_ns: npt.NDArray[np.int64], now_ns: int) -> None:
        """Queue frames that fit; a controller that takes no part in the bus gets its frames back unsent.

        Parameters are those of `bus.arbitration.queued_frames`.
        """
        queued = queued_frames(burst, durations_ns, now_ns, self._sequence, station.number)
        self._sequence += len(burst)
        self.counts.accepted += len(burst)
        if station.idle:
            is_idle = np.isin(queued["frame"]["port"], station.idle)
            self.discard(queued[is_idle], queued["release_ns"][is_idle])
            queued = queued[~is_idle]
        # Of records NumPy would compare all fields.
        both = np.concatenate((words(self.queued), words(queued)))
        self.queued, self._is_ascending = np.ndarray(len(both), QUEUED, both), False

    def discard(self, queued: Queued, time_ns: int | npt.NDArray[np.int64]) -> None:
        """Return frames to their sender unsent."""
        if len(queued):
            burst: Frames = queued["frame"].copy()
            burst["flags"] |= DISCARDED
            self.outbox.post(burst, time_ns, int(queued["station"][0]), OWNER)
            self.counts.discarded += len(queued)

    def withdraw(self, station: int, port: int | None = None) -> Queued:
        """Remove and return the waiting frames of a controller, or of a whole station, oldest first."""
        is_its = self.queued["station"] == station
        if port is not None:
            is_its &= self.queued["frame"]["port"] == port
        found: Queued = self.queued[is_its]
        self.queued = self.queued[~is_its]
        return np.sort(found, order="sequence")

    def take_back(self, station: Station) -> Frames:
        """Remove and return all waiting frames of a station; nothing is reported to it."""
        burst: Frames = self.withdraw(station.number)["frame"].copy()
        self.counts.discarded += len(burst)
        return burst[np.argsort(burst["port"], kind="stable")]

    # --- arbitration -------------------------------------------------------------------------------------

    def next_start_ns(self, free_ns: int) -> int | None:
        """Return the start of the next frame on a bus that is idle from `free_ns`."""
        first_ns = int(self.queued["release_ns"].min(initial=PARKED_NS))
        return None if first_ns == PARKED_NS else max(free_ns, first_ns)

    def waiting_ns(self, time_ns: int) -> int:
        """Return the time on the bus of the waiting frames that are released by `time_ns`."""
        return int(self.queued["duration_ns"][self.queued["release_ns"] <= time_ns].sum())

    def carry(self, free_ns: int, until_ns: int, intermission_ns: int, *, sends: bool) -> tuple[int, Winner | None]:
        """Send frames, see `bus.arbitration.carry`; return when the bus is idle, and the winner that waits, if any."""
        if not len(self.queued):
            return free_ns, None
        if not self._is_ascending:
            self.queued = self.queued[np.argsort(self.queued["release_ns"], kind="stable")]
            self._is_ascending = True
        carried = carry(words(self.queued), free_ns, until_ns, intermission_ns, sends)
        left, ended, sent, busy_ns, free_ns, start_ns, place = carried
        self.queued = np.ndarray(len(left), QUEUED, left)
        self.outbox.add(ended)
        self.counts.transmitted += sent
        self.counts.busy_ns += busy_ns
        self.counts.discarded += len(ended) - sent
        return free_ns, None if place < 0 else Winner(place, start_ns)

    def equals(self, winner: Winner) -> list[int]:
        """Return the places of the released frames with the identifier of a winner, in the order of submission."""
        queued = self.queued
        is_equal = (queued["key"] == queued["key"][winner.place]) & (queued["release_ns"] <= winner.start_ns)
        places = np.flatnonzero(is_equal)
        found: list[int] = places[np.argsort(queued["sequence"][places])].tolist()
        return found

    def delay(self, place: int, release_ns: int) -> None:
        """Let a frame take part in arbitration from `release_ns`; PARKED_NS: until `unpark`."""
        self.queued["release_ns"][place] = release_ns
        self._is_ascending = False

    def unpark(self, release_ns: int) -> None:
        """Return all parked frames to arbitration from `release_ns`."""
        is_parked = self.queued["release_ns"] == PARKED_NS
        if is_parked.any():
            self.queued["release_ns"][is_parked] = release_ns
            self._is_ascending = False

    def remove(self, places: list[int]) -> None:
        """Remove frames that were sent."""
        self.queued = np.delete(self.queued, places)
        self.counts.transmitted += len(places)

    def post_report(self, controller: Controller, time_ns: int, record: Frames) -> None:
        """Send a controller's station the report of an error or of a new state."""
        record["port"] = controller.port
        self.outbox.post(record, time_ns, controller.station, OWNER)
