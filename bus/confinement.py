"""Fault confinement (ISO 11898-1): error counters, error-passive and bus-off controllers, and their recovery."""

from collections.abc import Collection, Iterable, Mapping
from typing import Final

from bus.arbitration import PARKED_NS
from bus.controller import Controller
from bus.error_frames import State, ack_report, bit_report, state_report
from bus.station import Station, Stations
from bus.transmit_queues import TransmitQueues
from dbc.frame_bits import nominal_ns

#: Suspend transmission: an error-passive transmitter waits this number of bits.
SUSPEND_BITS: Final = 8
#: 128 occurrences of eleven recessive bits end bus-off; a frame contains one such occurrence.
OCCURRENCE_BITS: Final = 11
RECOVERY_BITS: Final = 128 * OCCURRENCE_BITS


class Confinement:
    """Effects of errors and good frames on the controllers of one bus.

    Parameters
    ----------
    restart_s : float
        Time that a bus-off controller waits before its recovery begins.
    """

    def __init__(self, stations: Stations, queues: TransmitQueues, bitrate: int, restart_s: float) -> None:
        self._stations = stations
        self._queues = queues
        self._bitrate = bitrate
        self._restart_ns = round(restart_s * 1e9)
        # A dict keeps the order of the errors; the order of a set would differ between runs.
        self._disturbed: dict[Controller, None] = {}
        self._recovering: list[Controller] = []

    def __bool__(self) -> bool:
        """Whether a good frame changes any counter."""
        return bool(self._disturbed or self._recovering)

    @property
    def next_recovery_ns(self) -> int | None:
        """When the next bus-off controller recovers."""
        if not self._recovering:
            return None
        return min(controller.recover_ns for controller in self._recovering)

    def forget(self, station: Station) -> None:
        """Remove the controllers of a station that has left."""
        for controller in station.controllers.values():
            self._disturbed.pop(controller, None)
        self._recovering = [one for one in self._recovering if one.station != station.number]

    def frame_failed(
        self, senders: Mapping[Controller, int], ended_ns: int, free_ns: int, *, unacknowledged: bool
    ) -> None:
        """Count the error of a frame, report it to the senders, and queue the frame again.

        Parameters
        ----------
        senders : mapping of Controller to int
            Place of the frame of each of its senders among the queued frames.
        ended_ns, free_ns : int
            End of the error frame, and of the intermission behind it.
        unacknowledged : bool
            Whether the error is a missing acknowledgement.
        """
        for controller in self._stations.controllers():
            if controller in senders:
                controller.transmit_failed(unacknowledged=unacknowledged)
            elif controller.takes_part and not unacknowledged:
                controller.receive_failed()
        report = ack_report if unacknowledged else bit_report
        for sender, place in senders.items():
            self._queues.post_report(sender, ended_ns, report(sender.transmit_errors, sender.receive_errors))
            is_parked = unacknowledged and sender.state is State.PASSIVE  # no retry until another controller joins
            self._queues.delay(place, PARKED_NS if is_parked else free_ns)
        self.judge(self._stations.controllers(), senders.keys(), ended_ns, free_ns)

    def frame_ended(self, senders: Collection[Controller], start_ns: int, ended_ns: int, free_ns: int) -> None:
        """Decrease the error counters of the senders and receivers of a good frame."""
        for controller in self._disturbed:
            if controller in senders:
                controller.transmitted()
            elif controller.takes_part:
                controller.received()
        for controller in self._recovering:
            if controller.restart_ns <= start_ns:  # the frame contained one of the 128 occurrences
                controller.recover_ns += free_ns - start_ns - nominal_ns(OCCURRENCE_BITS, self._bitrate)
        self.judge(list(self._disturbed), senders, ended_ns, free_ns)

    def recover(self) -> None:
        """Recover the controller whose recovery is due first."""
        first = min(self._recovering, key=lambda controller: controller.recover_ns)
        self._recovering.remove(first)
        first.reset()
        self._queues.post_report(first, first.recover_ns, state_report(State.ACTIVE, 0, 0, restarted=True))

    def judge(
        self, controllers: Iterable[Controller], senders: Collection[Controller], time_ns: int, free_ns: int
    ) -> None:
        """Compute the states from the counters, and report changed states; error-passive senders wait."""
        for controller in controllers:
            if not controller.takes_part:
                continue
            if controller.judge():
                errors = controller.transmit_errors, controller.receive_errors
                self._stations.by_number[controller.station].refresh()
                self._queues.post_report(controller, time_ns, state_report(controller.state, *errors))
            if controller.state is State.PASSIVE and controller in senders:
                controller.suspended_until_ns = free_ns + nominal_ns(SUSPEND_BITS, self._bitrate)
            if controller.state is State.BUS_OFF:
                self._go_off(controller, time_ns)
            elif controller.disturbed:
                self._disturbed[controller] = None
            else:
                self._disturbed.pop(controller, None)

    def _go_off(self, controller: Controller, time_ns: int) -> None:
        self._disturbed.pop(controller, None)
        self._queues.discard(self._queues.withdraw(controller.station, controller.port), time_ns)
        controller.restart_ns = time_ns + self._restart_ns
        controller.recover_ns = controller.restart_ns + nominal_ns(RECOVERY_BITS, self._bitrate)
        self._recovering.append(controller)
        self._stations.refresh()
        self._queues.unpark(time_ns)
