"""The transmit queues of all controllers of a bus: frames from submission to the report to the sender."""

from collections.abc import Iterable, Sequence
from itertools import count

from bus.controller import Controller
from bus.outbox import DISCARDED, OTHERS, OWNER, Outbox, burst_of, records_of
from bus.pending import Pending, Waiting, queueing
from bus.station import Counts, Station
from dbc.frame import Frames, frame_bytes


class TransmitQueues:
    """Frames that wait for the bus, and reports that wait for collection."""

    def __init__(self) -> None:
        self.pending = Pending()
        self.outbox = Outbox()
        self.counts = Counts()
        self._sequence = count()

    @staticmethod
    def fitting(station: Station, burst: Frames) -> int:
        """Count the leading frames that fit their transmit queues."""
        ports = burst["port"].tolist()
        left = dict.fromkeys(ports, station.queue_size)
        for port in left.keys() & station.controllers.keys():
            left[port] -= station.controllers[port].waiting
        if len(ports) <= min(left.values(), default=0):
            return len(ports)
        for place, port in enumerate(ports):
            if not left[port]:
                return place
            left[port] -= 1
        return len(ports)

    def submit(
        self, burst: Frames, controllers: Sequence[Controller], durations_ns: Sequence[int], now_ns: int
    ) -> None:
        """Queue frames that fit; a controller that takes no part in the bus gets its frames back unsent.

        Parameters
        ----------
        burst : array of FRAME, shape (n,)
        controllers : sequence of Controller, length n
            The sender of each frame.
        durations_ns : sequence of int, length n
            Time of each frame on the bus.
        now_ns : int
            Release time of frames without one.
        """
        keys, releases, expiries = queueing(frame_bytes(burst), now_ns).tolist()
        fields = zip(
            keys,
            self._sequence,
            records_of(burst),
            durations_ns,
            controllers,
            expiries,
            strict=False,  # the sequence is infinite
        )
        for item, release in zip(map(Waiting._make, fields), releases, strict=True):
            item.controller.waiting += 1
            if item.controller.takes_part:
                self.pending.add(item, release)
            else:
                self.discard([item], release)
        self.counts.accepted += len(burst)

    def discard(self, items: Iterable[Waiting], time_ns: int) -> None:
        """Return frames to their senders unsent."""
        for _, _, record, _, controller, _ in items:
            controller.waiting -= 1
            self.counts.discarded += 1
            self.outbox.post(time_ns, record, controller.station, OWNER, DISCARDED)

    def discard_expired(self, time_ns: int) -> None:
        """Return the frames that expired before they won arbitration."""
        if self.pending.expired:
            self.discard(self.pending.expired, time_ns)
            self.pending.expired.clear()

    def take_back(self, controller: Controller) -> Frames:
        """Remove and return all waiting frames of a controller; nothing is reported to the sender."""
        records = [item.record for item in self.pending.withdraw(controller)]
        controller.waiting -= len(records)
        self.counts.discarded += len(records)
        return burst_of(records)

    def post_copy(self, item: Waiting, time_ns: int) -> None:
        """Send a frame to the receivers; the sender gets its echo at another time."""
        self.outbox.post(time_ns, item.record, item.controller.station, OTHERS)

    def post_report(self, controller: Controller, time_ns: int, record: Frames) -> None:
        """Send a controller's station the report of an error or of a new state."""
        record["port"] = controller.port
        self.outbox.post(time_ns, record.tobytes(), controller.station, OWNER)
