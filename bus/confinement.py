"""Fault confinement (ISO 11898-1): error counters, error-passive and bus-off controllers, and their recovery."""

from collections.abc import Collection, Iterable, Sequence
from typing import Final

from bus.controller import Controller
from bus.error_frames import State, ack_report, bit_report, state_report
from bus.pending import Waiting
from bus.station import Station, Stations
from bus.transmit_queues import TransmitQueues
from dbc.frame_bits import nominal_ns

#: An error-passive transmitter lets others go first.
SUSPEND_BITS: Final = 8
#: 128 occurrences of eleven recessive bits end bus-off; a frame contains one occurrence.
OCCURRENCE_BITS: Final = 11
RECOVERY_BITS: Final = 128 * OCCURRENCE_BITS


class Confinement:
    """What errors and good frames do to the controllers of one bus.

    Parameters
    ----------
    bitrate : int
    restart_s : float
        How long a bus-off controller waits before it begins to recover.
    """

    def __init__(self, stations: Stations, queues: TransmitQueues, bitrate: int, restart_s: float) -> None:
        self._stations = stations
        self._queues = queues
        self._bitrate = bitrate
        self._restart_ns = round(restart_s * 1e9)
        # In the order in which they were disturbed: the order of a set would differ from run to run.
        self._disturbed: dict[Controller, None] = {}
        self._recovering: list[Controller] = []

    def __bool__(self) -> bool:
        """Whether a good frame changes any counter."""
        return bool(self._disturbed or self._recovering)

    @property
    def next_recovery_ns(self) -> int | None:
        """When the next bus-off controller recovers."""
        return min((controller.recover_ns for controller in self._recovering), default=None)

    def forget(self, station: Station) -> None:
        """Forget the controllers of a station that has left."""
        for controller in station.controllers.values():
            self._disturbed.pop(controller, None)
        self._recovering = [one for one in self._recovering if one.station != station.number]

    def frame_failed(self, items: Sequence[Waiting], ended_ns: int, free_ns: int, *, unacknowledged: bool) -> None:
        """Count the error of a frame, report it to its senders, and let them try again.

        Parameters
        ----------
        items : sequence of Waiting
            The frame as each of its senders has it.
        ended_ns, free_ns : int
            End of the error frame, and of the intermission behind it.
        unacknowledged : bool
            Whether the error is that nobody acknowledged.
        """
        senders = {item.controller for item in items}
        for controller in self._stations.controllers():
            if controller in senders:
                controller.transmit_failed(unacknowledged=unacknowledged)
            elif controller.takes_part and not unacknowledged:
                controller.receive_failed()
        report = ack_report if unacknowledged else bit_report
        for item in items:
            sender = item.controller
            self._queues.post_report(sender, ended_ns, report(sender.transmit_errors, sender.receive_errors))
            if unacknowledged and sender.state is State.PASSIVE:
                self._queues.pending.park(item)  # nothing changes until somebody else comes
            else:
                self._queues.pending.add(item, free_ns)
        self.judge(self._stations.controllers(), ended_ns, free_ns)

    def frame_ended(self, senders: Collection[Controller], start_ns: int, ended_ns: int, free_ns: int) -> None:
        """Let the error counters of a good frame's senders and receivers fall."""
        for controller in self._disturbed:
            if controller in senders:
                controller.transmitted()
            elif controller.takes_part:
                controller.received()
        for controller in self._recovering:
            if controller.restart_ns <= start_ns:  # the frame held one of its 128 occurrences
                controller.recover_ns += free_ns - start_ns - nominal_ns(OCCURRENCE_BITS, self._bitrate)
        self.judge(list(self._disturbed), ended_ns, free_ns)

    def recover(self) -> None:
        """Let the controller recover whose time comes first."""
        first = min(self._recovering, key=lambda controller: controller.recover_ns)
        self._recovering.remove(first)
        first.reset()
        self._queues.post_report(first, first.recover_ns, state_report(State.ACTIVE, 0, 0, restarted=True))

    def judge(self, controllers: Iterable[Controller], time_ns: int, free_ns: int) -> None:
        """Derive the states from the counters, and report those that changed."""
        for controller in controllers:
            if not controller.takes_part:
                continue
            if controller.judge():
                errors = controller.transmit_errors, controller.receive_errors
                self._stations.by_number[controller.station].refresh()
                self._queues.post_report(controller, time_ns, state_report(controller.state, *errors))
            if controller.state is State.PASSIVE:
                controller.suspended_until_ns = free_ns + nominal_ns(SUSPEND_BITS, self._bitrate)
            if controller.state is State.BUS_OFF:
                self._go_off(controller, time_ns)
            elif controller.disturbed:
                self._disturbed[controller] = None
            else:
                self._disturbed.pop(controller, None)

    def _go_off(self, controller: Controller, time_ns: int) -> None:
        self._disturbed.pop(controller, None)
        self._queues.withdraw(controller, time_ns)
        controller.restart_ns = time_ns + self._restart_ns
        controller.recover_ns = controller.restart_ns + nominal_ns(RECOVERY_BITS, self._bitrate)
        self._recovering.append(controller)
        self._stations.refresh()
        self._queues.pending.unpark(time_ns)
