"""The bus itself: an exact discrete-event model, without threads, sockets or a clock of its own.

Controllers submit frames with a release time; whenever the wire is free, the pending frame with the lowest
identifier is sent and takes exactly as long as its bits. `Bus.run_until` returns what ended until then.
"""

from collections.abc import Iterable, Sequence
from itertools import count
from random import Random
from typing import Final

import numpy as np

from bus.arbitration import arbitration_keys
from bus.controller import Controller
from bus.error_frames import State, ack_report, bit_report, state_report
from bus.faults import Fault, FaultBook, Odds
from bus.outbox import DISCARDED, OTHERS, OWNER, Events, Outbox
from bus.pending import Pending, Waiting
from bus.pool import FramePool
from bus.station import Counts, Station
from dbc.frame import Frames
from dbc.frame_bits import INTERMISSION_BITS, frame_time_ns

#: Error flag of the first controller and its echo by the others, error delimiter (ISO 11898-1, error frame).
ERROR_FRAME_BITS: Final = 6 + 6 + 8
#: An error-passive transmitter lets others go first.
SUSPEND_BITS: Final = 8
#: ACK delimiter, end of frame and intermission: the recessive bits behind the ACK slot of every frame.
_AFTER_ACK_BITS: Final = 1 + 7 + INTERMISSION_BITS
#: 128 occurrences of eleven recessive bits end bus-off; a frame contains one occurrence.
RECOVERY_BITS: Final = 128 * 11


class Bus:
    """One CAN bus and everybody on it.

    Parameters
    ----------
    bitrate, data_bitrate : int
        Bits per second in the nominal and in the data phase.
    faults : sequence of Fault
    seed : int
        Same seed and same submissions, same events.
    restart_s : float
        How long a bus-off controller waits before it begins to recover.
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
        self.counts = Counts()
        self.stations: dict[int, Station] = {}
        self._restart_ns = round(restart_s * 1e9)
        self._intermission_ns = round(INTERMISSION_BITS * 1e9 / bitrate)
        self._random = Random(seed)
        self._book = FaultBook(faults)
        self._sequence = count()
        self._numbers = count()
        self._pool = FramePool()
        self._outbox = Outbox(self._pool)
        self._pending = Pending()
        self._repeated: set[int] = set()
        self._free_ns = 0
        self._takers = 0
        self._disturbed: set[Controller] = set()
        self._recovering: list[Controller] = []

    # --- who is on the bus -------------------------------------------------------------------------------

    def attach(self, name: str, queue_size: int = 256, *, listen_only: bool = False) -> Station:
        """Connect a station with one controller, port 0; further ports come with their first frame.

        Parameters
        ----------
        name : str
            What faults are aimed at, as ``NAME:PORT``.
        queue_size : int
            Frames that each controller's transmit queue holds.
        listen_only : bool
            No controller that would acknowledge.
        """
        station = Station(next(self._numbers), name, queue_size)
        self.stations[station.number] = station
        if not listen_only:
            self._controller(station, 0)
        return station

    def detach(self, station: Station) -> None:
        """Disconnect a station; its waiting frames are never sent."""
        del self.stations[station.number]
        for controller in station.controllers.values():
            slots = [item.slot for item in self._pending.withdraw(controller)]
            self._pool.free(slots)
            self.counts.discarded += len(slots)
            self._disturbed.discard(controller)
        self._recovering = [one for one in self._recovering if one.station != station.number]
        self._membership_changed()

    def set_faults(self, faults: Sequence[Fault]) -> None:
        """Replace the rules; a controller that loses power loses its waiting frames."""
        self._book = FaultBook(faults)
        for controller in self._controllers():
            controller.off = self._book.is_off(controller.name)
            if controller.off:
                self._discard(self._pending.withdraw(controller), self.now_ns)
        self._membership_changed()

    def _controller(self, station: Station, port: int) -> Controller:
        """Return the controller at a port; the first time, power it up."""
        controller = station.controllers.get(port)
        if controller is None:
            controller = Controller(f"{station.name}:{port}", station.number, port)
            controller.off = self._book.is_off(controller.name)
            station.controllers[port] = controller
            self._membership_changed()
        return controller

    def _controllers(self) -> Iterable[Controller]:
        return (controller for station in self.stations.values() for controller in station.controllers.values())

    def _membership_changed(self) -> None:
        """Count who acknowledges, and give frames that found nobody another try."""
        self._takers = sum(controller.takes_part for controller in self._controllers())
        for station in self.stations.values():
            station.refresh()
        self._pending.unpark(self.now_ns)

    # --- frames in, events out ---------------------------------------------------------------------------

    def submit(self, station: Station, burst: Frames, time_ns: int = 0) -> int:
        """Put frames into the transmit queues of the controllers their `port` names.

        Parameters
        ----------
        burst : array of FRAME, shape (n,)
            Valid frames; `time_ns` is the earliest start of each, 0 for now, and `expires_ns` the latest, 0 for any.
        time_ns : int
            Now.

        Returns
        -------
        int
            How many were accepted, counted from the first; the next one found its queue full.
        """
        accepted = burst[: self._fitting(station, burst)]
        if not len(accepted):
            return 0
        self.now_ns = max(self.now_ns, time_ns)
        # A release time in the past holds while the wire has been idle since: a sender that the host let run
        # late is then as punctual on the bus as its hardware would have been.
        releases = np.where(accepted["time_ns"] > 0, accepted["time_ns"], self.now_ns).tolist()
        controllers = [self._controller(station, port) for port in accepted["port"].tolist()]
        fields = zip(
            arbitration_keys(accepted).tolist(),
            self._sequence,
            self._pool.store(accepted),
            frame_time_ns(accepted, self.bitrate, self.data_bitrate).tolist(),
            controllers,
            accepted["expires_ns"].tolist(),
            strict=False,  # the sequence has no end
        )
        for item, release in zip(map(Waiting._make, fields), releases, strict=True):
            item.controller.waiting += 1
            if item.controller.takes_part:
                self._pending.add(item, release)
            else:
                self._discard([item], release)
        self.counts.accepted += len(accepted)
        return len(accepted)

    def run_until(self, time_ns: int | None = None) -> Events:
        """Let time pass, and return what ended; without a time, run until nothing is left to happen."""
        while True:
            start = self._pending.next_start_ns(self._free_ns)
            if self._recovering and self._recover_before(start, time_ns):
                continue
            if start is None or (time_ns is not None and start > time_ns):
                break
            self.now_ns = max(self.now_ns, start)
            if self._book or self._disturbed or self._recovering or self._takers < 2:
                self._transmit(self._pending.winner(start), start)
            else:
                self._carry(start, time_ns)
            if self._pending.expired:
                self._discard(self._pending.expired, self.now_ns)
                self._pending.expired.clear()
        events = self._outbox.collect(time_ns)
        ended = int(events.frames["time_ns"][-1]) if len(events.frames) else 0
        self.now_ns = max(self.now_ns, time_ns or 0, ended)
        return events

    def next_event_ns(self) -> int | None:
        """Return when something ends or begins next, None when nothing will."""
        times = [controller.recover_ns for controller in self._recovering]
        coming = (self._outbox.next_ns(), self._pending.next_start_ns(self._free_ns))
        times += [time for time in coming if time is not None]
        return min(times, default=None)

    @property
    def crowded(self) -> bool:
        """Whether frames wait for the wire."""
        return self._pending.crowded

    def _fitting(self, station: Station, burst: Frames) -> int:
        """Count the leading frames that fit their transmit queues."""
        ports = burst["port"].tolist()
        room = dict.fromkeys(ports, station.queue_size)
        for port in room.keys() & station.controllers.keys():
            room[port] -= station.controllers[port].waiting
        if len(ports) <= min(room.values(), default=0):
            return len(ports)
        for place, port in enumerate(ports):
            if not room[port]:
                return place
            room[port] -= 1
        return len(ports)

    def _discard(self, items: Iterable[Waiting], time_ns: int) -> None:
        """Hand frames back to their senders unsent."""
        for _, _, slot, _, controller, _ in items:
            controller.waiting -= 1
            self.counts.discarded += 1
            self._outbox.post(time_ns, slot, controller.station, OWNER, DISCARDED)

    # --- the wire ----------------------------------------------------------------------------------------

    def _bits_ns(self, bits: int) -> int:
        return round(bits * 1e9 / self.bitrate)

    def _carry(self, start: int, time_ns: int | None) -> None:
        """Send frames as long as nothing can go wrong; the same as `_transmit` would do, without its questions."""
        pending, post = self._pending, self._outbox.post
        coming: int | None = start
        while coming is not None and (time_ns is None or coming <= time_ns):
            item = pending.winner(coming)
            if item is None or pending.contests(item):
                self._transmit(item, coming)
                return
            free = self._free_ns = coming + item.duration_ns
            post(free - self._intermission_ns, item.slot, item.controller.station, OTHERS | OWNER)
            item.controller.waiting -= 1
            self.counts.transmitted += 1
            self.counts.busy_ns += item.duration_ns
            coming = pending.next_start_ns(free)

    def _transmit(self, item: Waiting | None, start: int) -> None:
        """Send the winner of an arbitration, if there is one, or find out why that fails."""
        if item is None:
            return
        contested = self._pending.contests(item)
        if item.controller.suspended_until_ns > start:
            self._pending.add(item, item.controller.suspended_until_ns)
        else:
            self._attempt([item, *self._pending.rivals(item)] if contested else [item], start)

    def _attempt(self, items: list[Waiting], start: int) -> None:
        """Send a frame, or equal frames of several controllers, where something may go wrong."""
        _, sequence, slot, duration, sender, _ = items[0]
        clash_bits = clash(self._pool.slots[[item.slot for item in items]]) if len(items) > 1 else None
        odds = self._book.odds(sender.name, int(self._pool.slots["can_id"][slot]))
        intact = (1 - odds.bit_error) ** (duration * self.bitrate / 1e9)
        if clash_bits is not None:
            self._fail(items, start, self._bits_ns(clash_bits))
        elif self._takers < 2:
            self._fail(items, start, duration - self._bits_ns(_AFTER_ACK_BITS), unacknowledged=True)
        elif intact < 1 and self._random.random() >= intact:
            self._fail(items, start, self._random.randrange(duration))
        elif odds.duplicate and sequence not in self._repeated and self._random.random() < odds.duplicate:
            self._repeat(items, start, duration - self._intermission_ns)
        else:
            self._repeated.discard(sequence)
            self._succeed(items, start, odds)

    def _succeed(self, items: list[Waiting], start: int, odds: Odds | None = None) -> None:
        """End a frame well: receivers get it, and every controller that sent it is told."""
        duration = items[0].duration_ns
        self._free_ns = start + duration
        self.counts.busy_ns += duration
        ended = self._free_ns - self._intermission_ns
        audience = OTHERS | OWNER
        if odds and odds.loss and self._random.random() < odds.loss:
            audience = OWNER
            self.counts.lost += 1
        elif odds and odds.delay and self._random.random() < odds.delay:
            audience = OWNER
            self.counts.delayed += 1
            self._copy(items[0], ended + odds.delay_ns)
        for item in items:
            self._outbox.post(ended, item.slot, item.controller.station, audience)
            item.controller.waiting -= 1
            self.counts.transmitted += 1
            audience = OWNER
        if self._disturbed or self._recovering:
            self._reward({item.controller for item in items}, start, ended)

    def _copy(self, item: Waiting, time_ns: int) -> None:
        """Give receivers a frame whose sender has been, or will be, told separately."""
        self._outbox.post_copy(time_ns, self._pool.slots[[item.slot]], item.controller.station, OTHERS)

    def _repeat(self, items: list[Waiting], start: int, after_ns: int) -> None:
        """Disturb the last bit of end of frame: receivers keep the frame, its sender tries again."""
        self.counts.duplicated += 1
        self._repeated.add(items[0].sequence)
        self._copy(items[0], start + after_ns)
        self._fail(items, start, after_ns)

    def _fail(self, items: list[Waiting], start: int, after_ns: int, *, unacknowledged: bool = False) -> None:
        """End a frame with an error frame `after_ns`; its senders keep it and try again."""
        ended = start + after_ns + self._bits_ns(ERROR_FRAME_BITS)
        self._free_ns = ended + self._intermission_ns
        self.counts.errors += 1
        self.counts.busy_ns += self._free_ns - start
        senders = {item.controller for item in items}
        for controller in self._controllers():
            if controller in senders:
                controller.transmit_failed(unacknowledged=unacknowledged)
            elif controller.takes_part and not unacknowledged:
                controller.receive_failed()
        report = ack_report if unacknowledged else bit_report
        for item in items:
            sender = item.controller
            self._report(sender, ended, report(sender.transmit_errors, sender.receive_errors))
            if unacknowledged and sender.state is State.PASSIVE:
                self._pending.park(item)  # nothing changes until somebody else comes
            else:
                self._pending.add(item, self._free_ns)
        self._settle(self._controllers(), ended)

    def _reward(self, senders: set[Controller], start: int, ended: int) -> None:
        """Let the error counters of a good frame's sender and receivers fall."""
        for controller in self._disturbed:
            if controller in senders:
                controller.transmitted()
            elif controller.takes_part:
                controller.received()
        for controller in self._recovering:
            if controller.restart_ns <= start:  # the frame held one of its 128 occurrences
                controller.recover_ns += self._free_ns - start - self._bits_ns(11)
        self._settle(list(self._disturbed), ended)

    def _settle(self, controllers: Iterable[Controller], time_ns: int) -> None:
        """Derive the states from the counters, and tell who changed."""
        for controller in controllers:
            if not controller.takes_part:
                continue
            if controller.judge():
                errors = controller.transmit_errors, controller.receive_errors
                self.stations[controller.station].refresh()
                self._report(controller, time_ns, state_report(controller.state, *errors))
            if controller.state is State.PASSIVE:
                controller.suspended_until_ns = self._free_ns + self._bits_ns(SUSPEND_BITS)
            if controller.state is State.BUS_OFF:
                self._go_off(controller, time_ns)
            elif controller.disturbed:
                self._disturbed.add(controller)
            else:
                self._disturbed.discard(controller)

    def _go_off(self, controller: Controller, time_ns: int) -> None:
        self._disturbed.discard(controller)
        self._discard(self._pending.withdraw(controller), time_ns)
        controller.restart_ns = time_ns + self._restart_ns
        controller.recover_ns = controller.restart_ns + self._bits_ns(RECOVERY_BITS)
        self._recovering.append(controller)
        self._membership_changed()

    def _recover_before(self, start: int | None, time_ns: int | None) -> bool:
        """Let the first controller recover whose time comes before `start`, and tell whether one did."""
        first = min(self._recovering, key=lambda controller: controller.recover_ns)
        if any(end is not None and first.recover_ns > end for end in (start, time_ns)):
            return False
        self.now_ns = max(self.now_ns, first.recover_ns)
        self._recovering.remove(first)
        first.reset()
        self._report(first, first.recover_ns, state_report(State.ACTIVE, 0, 0, restarted=True))
        self._membership_changed()
        return True

    def _report(self, controller: Controller, time_ns: int, record: Frames) -> None:
        record["port"] = controller.port
        self._outbox.post_copy(time_ns, record, controller.station, OWNER)


def clash(same: Frames) -> int | None:
    """Return after how many bits frames with one identifier differ, roughly, or None when they never do."""
    first = same[0]
    if (same["length"] != first["length"]).any() or (same["flags"] != first["flags"]).any():
        return 19
    differs = (same["data"] != first["data"]).any(axis=0)
    return 19 + 8 * int(differs.argmax()) if differs.any() else None
