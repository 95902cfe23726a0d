"""The loop of a process of virtual nodes: receives SYNC, sends TPDOs and heartbeats, publishes the true forces."""

import os
import select
import time
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Final

from bus.link import Link
from canskin.fabric import Fabric
from canskin.messages import NODES, TRUTH, NodesStatus
from dbc.contract import Contract
from nodes.firmware.library import Firmware
from nodes.hardware import NEVER_S, Hardware
from nodes.segment import Boards, Segment
from nodes.virtual_boards import VirtualBoards
from shell.pulse import Beat, unheard
from shell.service import RateLimitedLog, StopSignal, request_real_time

#: Longest wait for frames.
TURN_S: Final = 0.005
STATUS_PERIOD_S: Final = 0.2
#: Longest wait for the last echoes when the process ends.
LAST_FRAMES_S: Final = 0.5
#: With several buses, the next cycle is sampled ahead from this part of the period after a SYNC on: all buses have had
#: their answers by then.
PREPARE_FROM: Final = 0.3


#: Waits for frames at most for a number of seconds, with ``whole=True`` all that time; returns links with frames.
Wait = Callable[..., Collection[Link]]


def wait_on_sockets(links: Collection[Link], wait_s: float, *, whole: bool) -> Collection[Link]:
    """Wait as `Wait` does on links that have sockets."""
    if whole:
        time.sleep(max(0.0, wait_s))
    ready: list[Link] = select.select(links, [], [], 0.0 if whole else wait_s)[0]
    return ready


class NodesService:
    """Virtual nodes on one or more buses.

    Parameters
    ----------
    links : mapping of int to Link
        By number of the bus.
    node_ids : mapping of int to collection of int
        The nodes of each bus that this process runs.
    hardware : Hardware
        Of all these nodes (`nodes.sending`).
    fabric : Fabric or None
        Where counters and true forces are published.
    store : Path, optional
        Folder for the parameters that 1010h stores.
    unnumbered : bool
        Whether nodes without a stored node-ID wait for LSS.
    firmware : Firmware, optional
        Compiled for these nodes: C boards run in place of nodes in Python. The hardware is made for them.
    wait : Wait, optional
        Waits for frames; default: on sockets.
    clock : callable, optional
        Monotonic time in seconds.
    """

    def __init__(
        self,
        contract: Contract,
        links: Mapping[int, Link],
        node_ids: Mapping[int, Collection[int]],
        hardware: Hardware,
        fabric: Fabric | None = None,
        *,
        store: Path | None = None,
        unnumbered: bool = False,
        firmware: Firmware | None = None,
        wait: Wait = wait_on_sockets,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        def new_segment(bus: int, link: Link) -> Segment:
            boards: Boards = (
                VirtualBoards(contract, bus, node_ids[bus], hardware, store=store, unnumbered=unnumbered)
                if firmware is None
                else firmware.boards(bus)
            )
            return Segment(contract, bus, boards, hardware, link.send, complain=RateLimitedLog("nodes").say)

        self.segments = {bus: new_segment(bus, link) for bus, link in links.items()}
        self._links = dict(links)
        self._hardware = hardware
        self._fabric = fabric
        self._wait, self._clock = wait, clock
        self._status_at_s = 0.0
        self._prepare_after_s = PREPARE_FROM * contract.layout.sync.period_s if len(links) > 1 else 0.0

    def run(self, stop: StopSignal, beat: Beat = unheard) -> None:
        """Boot the nodes, then serve until `stop`."""
        for segment in self.segments.values():
            segment.boot(self._clock())
        request_real_time("nodes", None if self._fabric is None else self._fabric.tell_scheduling)
        while not stop.is_set():
            self.turn()
            beat(self.frames_sent)
        self._await_frames()
        self.publish_status()

    def _await_frames(self) -> None:
        """Wait for the echoes of frames that may still be sent, so that the counters tell what receivers got."""
        until_s = time.monotonic() + LAST_FRAMES_S
        while self._hardware.is_sending and (left_s := until_s - time.monotonic()) > 0:
            self._receive(self._wait(self._links.values(), left_s, whole=False), self._clock())

    def _receive(self, ready: Collection[Link], now_s: float) -> None:
        for bus, link in self._links.items():
            if link in ready:
                self.segments[bus].take(link.receive(), now_s)

    def turn(self) -> None:
        """Wait for frames up to `TURN_S`, or for the next sample; handle frames, and do what is due by time."""
        # With samples by time one turn for each sample: frames wait for it, a millisecond at most.
        is_timed = self._hardware.due_s != NEVER_S
        wait_s = min(self._hardware.due_s - self._clock(), TURN_S)
        ready = self._wait(self._links.values(), wait_s, whole=is_timed)
        now_s = self._clock()
        self._receive(ready, now_s)
        for segment in self.segments.values():
            segment.tick(now_s)
        self._publish(now_s)
        if now_s - max(segment.sync_at_s for segment in self.segments.values()) >= self._prepare_after_s:
            self._hardware.prepare()

    @property
    def frames_sent(self) -> int:
        """Number of frames that the boards have sent."""
        return sum(segment.frames_sent for segment in self.segments.values())

    def publish_status(self) -> None:
        """Publish the counters of all segments."""
        if self._fabric is None:
            return
        status = NodesStatus(
            time_ns=time.time_ns(),
            process=str(os.getpid()),
            frames_sent=self.frames_sent,
            frames_dropped=sum(segment.frames_dropped for segment in self.segments.values()),
            syncs_seen=max(segment.syncs_seen for segment in self.segments.values()),
        )
        self._fabric.publish(NODES, status)

    def _publish(self, now_s: float) -> None:
        if self._fabric is None:
            return
        while (truth := self._hardware.take_truth()) is not None:
            self._fabric.publish(TRUTH, truth)
        if now_s >= self._status_at_s:
            self._status_at_s = now_s + STATUS_PERIOD_S
            self.publish_status()
