"""The gateway's process: receives frames, sends SYNC at absolute times, publishes measurements."""

import time
from collections.abc import Callable, Mapping
from typing import Final

import msgspec
import numpy as np

from bus.intake import Readable, attach
from bus.link import Link, State
from bus.told import DROPPED, IS_READY
from canskin.fabric import Fabric
from canskin.messages import GATEWAY, MEASUREMENT, Measurement
from dbc.contract import Contract
from dbc.frame import frames
from gateway.calibration import GatewayCalibration
from gateway.duty import Duties
from gateway.loop import GatewayLoop
from gateway.sdo import TIMEOUT_S
from gateway.stepped_gathering import RATES_HZ
from shell.clock import wall_offset
from shell.compiled import hold
from shell.pulse import Beat, unheard
from shell.service import RateLimitedLog, StopSignal, request_real_time, say

STATUS_PERIOD_S: Final = 0.2
#: Longest wait for frames.
TURN_S: Final = 0.01
#: Calibration works when nothing is due for `SPARE_S`: a window of 4096 taxels takes 2 ms, of 65,536 some 30 ms.
SPARE_S: Final = 0.004
#: Pause between two looks at a transmit queue that is full, at the end.
FLUSH_S: Final = 0.001
_NOTHING: Final = frames(0)


class GatewayService:
    """Runs a `GatewayLoop` on links and a fabric.

    Parameters
    ----------
    links : mapping of int to Link
        By number of the bus.
    calibration : GatewayCalibration, optional
        Without it measurements have no offsets.
    rates_hz : tuple of float
        See `GatewayLoop`.
    duties : Duties, optional
        Without them all who make images or labels publish them.
    clock : callable, optional
        Monotonic time in seconds.
    """

    def __init__(
        self,
        contract: Contract,
        links: Mapping[int, Link],
        fabric: Fabric,
        *,
        calibration: GatewayCalibration | None = None,
        rates_hz: tuple[float, float] = RATES_HZ,
        duties: Duties | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._calibration, self._duties = calibration, duties
        self.loop = GatewayLoop(
            contract,
            {number: link.send for number, link in links.items()},
            clock(),
            say=lambda text: say("gateway", text),
            complain=RateLimitedLog("gateway").say,
            rates_hz=rates_hz,
            early_echoes=[number for number, link in links.items() if not link.proves_echo],
        )
        self._links = dict(sorted(links.items()))
        self._turn = self.loop.new_turn()
        self._held = hold(self._turn)
        self.loop.turn(0, 0, self._held)  # compiled before there is a frame
        attach(list(self._links.values()), self._turn.intake)
        self._fabric = fabric
        self._clock = clock
        self._status_at_s = 0.0
        self._wall_offset_ns = wall_offset().ns

    def run(self, stop: StopSignal, beat: Beat = unheard) -> None:
        """Boot the nodes, then serve until `stop`; open cycles are finished before the return.

        While SYNC runs, turns without measurements are no progress.
        """
        request_real_time("gateway", self._fabric.tell_scheduling)
        made = 0
        while not stop.is_set():
            self.turn()
            if self.loop.gathering.published > made or not self.loop.sync.runs:
                made = self.loop.gathering.published
                beat(made)
        self.loop.sync.stop()
        while self.loop.in_flight:
            self.turn()
        self.publish_status()
        self.loop.stop()
        give_up_s = self._clock() + TIMEOUT_S
        while self.loop.flush() and self._clock() < give_up_s:
            time.sleep(FLUSH_S)

    def publish_status(self) -> None:
        """Publish all counters."""
        self.loop.report_links(self._links, self._clock())
        states = {number: (link.state, link.dropped) for number, link in self._links.items()}
        status = self.loop.status(states, self._clock())
        if self._calibration is not None:
            frozen = map(self._calibration.frozen_on, sorted(self._links))
            buses = [
                msgspec.structs.replace(bus, faults=faults | bus.faults)
                for bus, faults in zip(status.buses, frozen, strict=True)
            ]
            status = msgspec.structs.replace(status, calibration=self._calibration.status(), buses=buses)
        self._fabric.publish(GATEWAY, status)

    def turn(self) -> None:
        """Wait for the next SYNC, for frames, or for a measurement, and do what is due: SYNC first.

        The clock is read before each step: any step may be delayed, and the lateness of SYNC must be known.
        """
        restless = self.loop.turn(*self.waits_ns(), self._held)
        if self.loop.due_s <= self._clock():
            self._wall_offset_ns = wall_offset().ns
        closed = self.loop.send_sync(self._clock(), self._wall_offset_ns)
        if restless:
            self._take()
        self.loop.tick(self._clock())
        if self._calibration is not None:
            self._calibration.look(self.loop.masters, self._clock())
        if self._duties is not None:
            self._duties.turn(self._clock())
        self.publish(closed + self.loop.measurements(self._clock(), self._wall_offset_ns))
        if self._calibration is not None:
            self._calibration.tick(self.loop.masters, self._clock())
            if self.loop.due_s - self._clock() >= SPARE_S:
                self._calibration.work()
        if self._clock() >= self._status_at_s:
            self._status_at_s = self._clock() + STATUS_PERIOD_S
            self.publish_status()

    def waits_ns(self) -> tuple[int, int]:
        """Return for how long to rest, and for how long to wait for frames, the rest included."""
        now_s = self._clock()
        rest_s, wait_s = self.loop.may_sleep_until_s - now_s, self.loop.due_s - now_s
        return round(1e9 * max(0.0, min(rest_s, TURN_S))), round(1e9 * max(0.0, min(wait_s, TURN_S)))

    def _take(self) -> None:
        """Use the frames of the buses that are not calm, and look at their links."""
        told, rows = self._turn.intake.told, self._turn.intake.rows
        for number in np.flatnonzero(~self._turn.is_calm).tolist():
            link, arrived = self._links[number], _NOTHING
            if isinstance(link, Readable):
                arrived = link.arrived(rows[number])
            elif told[number, IS_READY]:
                arrived = link.receive()
            self._turn.dropped[number] = told[number, DROPPED]
            self._turn.is_restless[number] = self.loop.take(
                number,
                arrived,
                self._clock(),
                state=link.state,
                dropped=link.dropped,
                stamp_error_ns=link.stamp_error_ns,
            )
            self._turn.is_restless[number] |= link.state is not State.ACTIVE

    def publish(self, measurements: list[Measurement]) -> None:
        """Publish measurements with their offsets, and with who publishes what is made of them."""
        for each in measurements:
            whole = each if self._calibration is None else self._calibration.apply(each)
            if self._duties is not None:
                whole = msgspec.structs.replace(whole, duty=self._duties.words)
                self._duties.sent(self._clock())
            self._fabric.publish(MEASUREMENT, whole)
            if self._calibration is not None:
                self._calibration.take(each)
