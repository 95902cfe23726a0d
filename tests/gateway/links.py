"""A whole skin as in `World`, whose frames go over real links: each is awaited, so that time is the test's alone."""

import select
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import ClassVar

import numpy as np

from bus.link import Link
from dbc.canopen import SYNC_COB_ID
from dbc.frame import ECHO, ERROR, Frames, frames
from tests.bus.serial_adapter import SerialAdapter
from tests.layouts import TURNS, small_contract
from tests.processes import PATIENCE_S
from tests.world import EndOfWire, Wire, World, valid

#: With periods and steps that a float has exactly: a SYNC is sent in each second step, whenever the first was due.
RATE_HZ = 16.0
CONTRACTS = {turns: small_contract(RATE_HZ, turns) for turns in TURNS}
NODES = [(node.bus, node.node_id) for node in CONTRACTS[1].nodes]
#: SYNCs of a run: in order; each with a disturbance; in order again.
ORDERLY, DISTURBED, AFTER = 20, 60, 6
#: Of the echoes of the gateway's interface, see `LinkWire`.
SEEDS = (None, 1, 2)
#: What a run has measured: counter, validity and sums of each cycle.
Cycles = list[tuple[int, list[bool], bytes]]
#: The gateway's end and that of the nodes.
Ends = tuple[Link, Link | SerialAdapter]


class LinkWire(Wire):
    """A wire that is two links.

    Parameters
    ----------
    seed : int, optional
        With it the gateway's interface holds back its echoes, hands them on in groups and in any order, at any place
        among the frames that it receives then.
    """

    def __init__(self, ends: Ends, seed: int | None = None) -> None:
        super().__init__()
        self.is_plugged = True
        self.proves_echo = ends[0].proves_echo
        self._links = dict(zip((self.gateway, self.nodes), ends, strict=True))
        self._random = None if seed is None else np.random.default_rng(seed)
        self._echoes = frames(0)

    def deliver(self) -> bool:
        came = super().deliver()
        if self._random is None or not len(self._echoes) or self._random.random() < 0.6:
            return came
        stream = np.concatenate([frames(0), *self.gateway.arriving.take(self.now_ns)])
        for echo in self._random.permutation(self._echoes):
            place = self._random.integers(len(stream) + 1)
            stream = np.concatenate([stream[:place], [echo], stream[place:]])
        self.gateway.arriving.put(stream, self.now_ns)
        self._echoes = frames(0)
        return True

    def _carry(self, sender: EndOfWire | None, burst: Frames) -> None:
        assert sender is not None
        if not self.is_plugged:
            return
        sent = burst.copy()
        sent["time_ns"] = sent["expires_ns"] = 0  # of the test's time
        assert self._links[sender].send(sent) == len(sent)
        super()._carry(sender, burst)

    def _arrived(self, end: EndOfWire, sender: EndOfWire | None, burst: Frames) -> Frames:
        if sender is self.nodes is end:
            return super()._arrived(end, sender, burst)
        link, kind, until_s = self._links[end], ECHO if end is sender else 0, time.monotonic() + PATIENCE_S
        came = frames(0)
        while len(came) < len(burst):
            assert time.monotonic() < until_s, f"{len(came)} of {len(burst)} frames came"
            select.select([link], [], [], 0.1)
            arrived = link.receive()
            came = np.concatenate([came, arrived[arrived["flags"] & (ECHO | ERROR) == kind]])
        came["time_ns"] = self.now_ns
        if kind and self._random is not None:
            self._echoes, came = np.concatenate([self._echoes, came]), frames(0)
        return came


@dataclass
class LinkWorld(World):
    """A skin on links; for `seed` see `LinkWire`."""

    links: Sequence[Ends] = ()
    seed: int | None = None
    step_s: ClassVar[float] = 0.5 / RATE_HZ

    def new_wire(self, bus: int) -> Wire:
        return LinkWire(self.links[bus], None if self.seed is None else self.seed + bus) if self.links else Wire()


def measured(world: World) -> Cycles:
    """Go through a run in which no two samples are alike: boards hang for up to three periods, or miss a SYNC."""
    random = np.random.default_rng(1)
    for count in range(ORDERLY + DISTURBED + AFTER):
        world.until_sync()
        for wire in world.wires:
            wire.loses = None
        if not ORDERLY <= count < ORDERLY + DISTURBED:
            continue
        bus, node_id = NODES[random.integers(len(NODES))]
        wire, what, steps = world.wires[bus], random.integers(4), random.integers(1, 7) + 0.5
        if what == 0:
            wire.hang(node_id, round((world.now_s + steps * world.step_s) * 1e9))
        elif what == 1:
            wire.loses = misses_sync(wire)
    assert not any(map(world.wrong_blocks, world.measured))
    return [(each.sync_counter, valid(each).tolist(), each.sums) for each in world.measured]


def misses_sync(wire: Wire) -> Callable[[EndOfWire, np.void], bool]:
    return lambda end, each: end is wire.nodes and bool(each["can_id"] == SYNC_COB_ID)


@cache
def without_links(turns: int) -> Cycles:
    return measured(LinkWorld(CONTRACTS[turns]))


def check_same(links: Sequence[Ends], turns: int, seed: int | None) -> None:
    """Check that a run on links measures what the same run without links measures, and all while it is in order."""
    cycles = measured(LinkWorld(CONTRACTS[turns], links=links, seed=seed))
    assert [counter for counter, _, _ in cycles[: ORDERLY - 1]] == list(range(1, ORDERLY))
    assert all(all(is_valid) for _, is_valid, _ in cycles[turns - 1 : ORDERLY - 1])
    assert cycles == without_links(turns)
