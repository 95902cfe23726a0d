"""The loop of a process of virtual nodes: receives SYNC, sends TPDOs and heartbeats, publishes the true forces."""

import os
import selectors
import time
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Final

from bus.link import Link
from dbc.contract import Contract
from nodes.sampler import Sampler
from nodes.segment import Segment
from skin.fabric import Fabric
from skin.messages import NODES, TRUTH, NodesStatus
from skin.service import StopSignal, be_punctual

#: Longest wait for frames.
TURN_S: Final = 0.005
STATUS_PERIOD_S: Final = 0.2


class NodesService:
    """Virtual nodes on one or more buses.

    Parameters
    ----------
    contract : Contract
    links : mapping of int to Link
        By number of the bus.
    node_ids : mapping of int to collection of int
        The nodes of each bus that this process runs.
    sampler : Sampler
    fabric : Fabric or None
        Where counters and true forces are published.
    store : Path, optional
        Folder for the parameters that 1010h stores.
    """

    def __init__(
        self,
        contract: Contract,
        links: Mapping[int, Link],
        node_ids: Mapping[int, Collection[int]],
        sampler: Sampler,
        fabric: Fabric | None = None,
        *,
        store: Path | None = None,
    ) -> None:
        self.segments = [
            Segment(contract, bus, node_ids[bus], link, sampler, store=store) for bus, link in links.items()
        ]
        self._sampler = sampler
        self._fabric = fabric
        self._status_at_s = 0.0

    def run(self, stop: StopSignal) -> None:
        """Boot the nodes, then serve until `stop`."""
        with selectors.DefaultSelector() as selector:
            for segment in self.segments:
                selector.register(segment.link.fileno(), selectors.EVENT_READ, segment)
                segment.boot(time.monotonic())
            be_punctual()
            while not stop.is_set():
                ready = selector.select(TURN_S)
                now_s = time.monotonic()
                for key, _ in ready:
                    key.data.receive(now_s)
                for segment in self.segments:
                    segment.tick(now_s)
                self._publish(now_s)
        self.publish_status()

    def publish_status(self) -> None:
        """Publish the counters of all segments."""
        if self._fabric is None:
            return
        status = NodesStatus(
            time_ns=time.time_ns(),
            process=str(os.getpid()),
            frames_sent=sum(segment.frames_sent for segment in self.segments),
            frames_dropped=sum(segment.frames_dropped for segment in self.segments),
            syncs_seen=max(segment.syncs_seen for segment in self.segments),
        )
        self._fabric.publish(NODES, status)

    def _publish(self, now_s: float) -> None:
        if self._fabric is None:
            return
        truth = self._sampler.take_truth()
        if truth is not None:
            self._fabric.publish(TRUTH, truth)
        if now_s >= self._status_at_s:
            self._status_at_s = now_s + STATUS_PERIOD_S
            self.publish_status()
