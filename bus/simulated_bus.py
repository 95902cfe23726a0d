"""A CAN bus with arbitration: an exact discrete-event model, without threads, sockets or clock.

Controllers submit frames with a release time. When the bus is idle, the waiting frame with the lowest identifier is
sent; its time is exactly that of its bits. `SimulatedBus.run_until` returns all frames and reports that ended up to a
time. `bus.faults` draws faults; `bus.confinement` computes their effect on the controllers.
"""

from collections.abc import Sequence
from typing import Final

from bus.arbitration import FOREVER_NS, OTHERS, OWNER, Queued, clash_bits
from bus.confinement import Confinement
from bus.controller import Controller
from bus.faults import Fault, FaultSchedule, Odds
from bus.outbox import Events
from bus.station import Counts, Station, Stations
from bus.transmit_queues import TransmitQueues, Winner
from dbc.frame import Frames
from dbc.frame_bits import INTERMISSION_BITS, frame_time_ns, nominal_ns

#: Error flag of the first controller and its echo by the others, error delimiter (ISO 11898-1, error frame).
ERROR_FRAME_BITS: Final = 6 + 6 + 8
#: ACK delimiter, end of frame and intermission: the recessive bits after the ACK slot of every frame.
_AFTER_ACK_BITS: Final = 1 + 7 + INTERMISSION_BITS


class SimulatedBus:
    """One CAN bus with its stations.

    Parameters
    ----------
    bitrate, data_bitrate : int
        Bits per second in the nominal and in the data phase.
    seed : int
        The same seed and the same submissions give the same events.
    restart_s : float
        Time that a bus-off controller waits before its recovery begins.
    """

    def __init__(
        self,
        bitrate: int = 1_000_000,
        data_bitrate: int | None = None,
        *,
        faults: Sequence[Fault] = (),
        seed: int = 0,
        restart_s: float = 0.1,
    ) -> None:
        self.bitrate = bitrate
        self.data_bitrate = data_bitrate
        self.now_ns = 0
        self._intermission_ns = nominal_ns(INTERMISSION_BITS, bitrate)
        self._stations = Stations()
        self._queues = TransmitQueues()
        self._faults = FaultSchedule(faults, seed)
        self._confinement = Confinement(self._stations, self._queues, bitrate, restart_s)
        self._free_ns = 0

    @property
    def counts(self) -> Counts:
        """Counters since the start of the bus."""
        return self._queues.counts

    @property
    def idle_from_ns(self) -> int:
        """When the released frames that wait will have been sent, if no other comes, and none fails."""
        start_ns = self._queues.next_start_ns(self._free_ns) or self._free_ns
        return start_ns + self._queues.waiting_ns(start_ns)

    # --- who is on the bus -------------------------------------------------------------------------------

    def attach(self, name: str, queue_size: int = 256) -> Station:
        """Connect a station with one controller, port 0; the first frame of another port adds a controller.

        Parameters
        ----------
        name : str
            Faults select the station's controllers as ``NAME:PORT``.
        queue_size : int
            Number of frames in each controller's transmit queue.
        """
        station = self._stations.add(name, queue_size)
        self._controller(station, 0)
        return station

    def detach(self, station: Station) -> None:
        """Disconnect a station; its waiting frames are dropped."""
        self._stations.remove(station)
        self._queues.take_back(station)
        self._confinement.forget(station)
        self._refresh()

    def _controller(self, station: Station, port: int) -> Controller:
        """Return the controller at a port; the first call makes the controller."""
        controller = station.controllers.get(port)
        if controller is None:
            controller = Controller(f"{station.name}:{port}", station.number, port)
            controller.off = self._faults.is_off(controller.name)
            station.controllers[port] = controller
            self._refresh()
        return controller

    def _refresh(self) -> None:
        """Count the controllers that acknowledge, and retry frames that were not acknowledged."""
        self._stations.refresh()
        self._queues.unpark(self.now_ns)

    # --- frames in, events out ---------------------------------------------------------------------------

    def submit(self, station: Station, burst: Frames, time_ns: int = 0) -> int:
        """Put frames into the transmit queues of the controllers at their `port`.

        Parameters
        ----------
        burst : array of FRAME, shape (n,)
            Valid frames; `time_ns` is the earliest start, 0 for now, and `expires_ns` the latest, 0 for no limit.
        time_ns : int
            Now.

        Returns
        -------
        int
            Number of accepted frames, counted from the first; the queue of the next frame was full.
        """
        accepted = burst[: self._queues.fitting(station, burst)]
        if not len(accepted):
            return 0
        self.now_ns = max(self.now_ns, time_ns)
        for port in dict.fromkeys(accepted["port"].tolist()):
            self._controller(station, port)
        durations_ns = frame_time_ns(accepted, self.bitrate, self.data_bitrate)
        self._queues.submit(accepted, station, durations_ns, self.now_ns)
        return len(accepted)

    def take_back(self, station: Station) -> Frames:
        """Remove and return the waiting frames of a station, each controller's oldest first."""
        return self._queues.take_back(station)

    def waiting(self, station: Station) -> int:
        """Return the number of frames of a station that wait."""
        return len(self._queues.waiting(station))

    def run_until(self, time_ns: int | None = None) -> Events:
        """Simulate up to `time_ns`, and return what ended; without a time, run until no event is left."""
        limit_ns = FOREVER_NS if time_ns is None else time_ns
        while True:
            recover_ns = self._confinement.next_recovery_ns
            until_ns = limit_ns if recover_ns is None else min(limit_ns, recover_ns - 1)
            sends = not (self._faults or self._confinement or self._stations.takers < 2)
            self._free_ns, winner = self._queues.carry(self._free_ns, until_ns, self._intermission_ns, sends=sends)
            if winner is not None:
                self.now_ns = max(self.now_ns, winner.start_ns)
                self._transmit(winner)
            elif recover_ns is None or recover_ns > limit_ns:
                break
            else:
                self.now_ns = max(self.now_ns, recover_ns)
                self._confinement.recover()
                self._refresh()
        events = self._queues.outbox.collect(limit_ns)
        ended = int(events.frames["time_ns"][-1]) if len(events.frames) else 0
        self.now_ns = max(self.now_ns, time_ns or 0, ended)
        return events

    def next_event_ns(self) -> int | None:
        """Return the time of the next event, None if there is none."""
        starts = self._queues.next_start_ns(self._free_ns)
        coming = (self._confinement.next_recovery_ns, self._queues.outbox.next_ns, starts)
        return min((time for time in coming if time is not None), default=None)

    # --- the wire, where faults are possible -------------------------------------------------------------

    def _transmit(self, winner: Winner) -> None:
        """Send the winner of an arbitration, with equal frames of others, or find the reason of its failure."""
        senders: dict[Controller, int] = {}
        queued = self._queues.queued
        for place in [winner.place, *self._queues.equals(winner)]:
            station = self._stations.by_number[int(queued["station"][place])]
            senders.setdefault(station.controllers[int(queued["frame"]["port"][place])], place)
        suspended_until_ns = next(iter(senders)).suspended_until_ns
        if suspended_until_ns > winner.start_ns:
            self._queues.delay(winner.place, suspended_until_ns)
        else:
            self._attempt(senders, winner.start_ns)

    def _attempt(self, senders: dict[Controller, int], start: int) -> None:
        """Send a frame, or equal frames of several controllers, by their places, with possible faults."""
        items, faults = self._queues.queued[list(senders.values())], self._faults
        same, duration, sequence = items["frame"], int(items["duration_ns"][0]), int(items["sequence"][0])
        clash = clash_bits(same) if len(items) > 1 else None
        odds = faults.odds(next(iter(senders)).name, int(same["can_id"][0]))
        if clash is not None:
            self._fail(senders, start, nominal_ns(clash, self.bitrate))
        elif self._stations.takers < 2:
            self._fail(senders, start, duration - nominal_ns(_AFTER_ACK_BITS, self.bitrate), unacknowledged=True)
        elif (after_ns := faults.draw_error_ns(odds, duration, self.bitrate)) is not None:
            self._fail(senders, start, after_ns)
        elif faults.draw_duplicate(odds, sequence):
            # The last bit of end of frame is disturbed: receivers keep the frame, the sender sends it again.
            self.counts.duplicated += 1
            after_ns = duration - self._intermission_ns
            self._post(items[:1], start + after_ns, OTHERS)
            self._fail(senders, start, after_ns)
        else:
            self._succeed(senders, items, start, odds)

    def _succeed(self, senders: dict[Controller, int], items: Queued, start: int, odds: Odds) -> None:
        """End a good frame: receivers get the frame, and each of its senders an echo."""
        duration = int(items["duration_ns"][0])
        self._free_ns = start + duration
        self.counts.busy_ns += duration
        ended = self._free_ns - self._intermission_ns
        audience = OTHERS | OWNER
        if self._faults.draw(odds.loss):
            audience = OWNER
            self.counts.lost += 1
        elif self._faults.draw(odds.delay):
            audience = OWNER
            self.counts.delayed += 1
            self._post(items[:1], ended + odds.delay_ns, OTHERS)
        self._queues.remove(list(senders.values()))
        for place in range(len(items)):
            self._post(items[place : place + 1], ended, audience)
            audience = OWNER
        if self._confinement:
            self._confinement.frame_ended(senders.keys(), start, ended, self._free_ns)

    def _post(self, item: Queued, time_ns: int, audience: int) -> None:
        self._queues.outbox.post(item["frame"], time_ns, int(item["station"][0]), audience)

    def _fail(self, senders: dict[Controller, int], start: int, after_ns: int, *, unacknowledged: bool = False) -> None:
        """End a frame with an error frame `after_ns`; the senders send it again."""
        ended = start + after_ns + nominal_ns(ERROR_FRAME_BITS, self.bitrate)
        self._free_ns = ended + self._intermission_ns
        self.counts.errors += 1
        self.counts.busy_ns += self._free_ns - start
        self._confinement.frame_failed(senders, ended, self._free_ns, unacknowledged=unacknowledged)
