"""Boards without node-ID on one arbitrated bus, and a `skin commission` whose clock the test moves."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from bus.outbox import OTHERS, OWNER, Events
from bus.simulated_bus import SimulatedBus
from bus.station import Station
from dbc.contract import Contract
from dbc.frame import ECHO, Frames
from gateway.commissioning import Commissioning
from nodes.segment import Boards
from nodes.virtual_boards import VirtualBoards
from tests.layouts import buses, small_layout
from tests.nodes.helpers import new_sampler

#: A board answers after at most this time.
SLOWEST_NS = 20_000_000


def skin(nodes: int, **tables: Any) -> Contract:
    """Return the contract of boards of 32 taxels on one bus of 1 Mbit/s."""
    return Contract.from_layout(small_layout(8, 4 * nodes, **{"bus": buses(nodes)} | tables))


@dataclass
class Place:
    """A board and its controller."""

    boards: Boards
    station: Station
    #: The board has power while this is true; called with each request of LSS before the board takes the request.
    lives: Callable[[bytes], bool] = lambda _: True
    is_alive: bool = True


class Bench:
    """A bus, its boards, and the master; time is that of the bus."""

    def __init__(self, contract: Contract, seed: int = 1) -> None:
        self.contract = contract
        self.wire = SimulatedBus(contract.layout.bus[0].bitrate, seed=seed)
        self.master = self.wire.attach("master")
        self.random = np.random.default_rng(seed)
        self.now_ns = 10**9
        self.places: list[Place] = []

    def add(self, node_id: int, *, contract: Contract | None = None, numbered: bool = False) -> Place:
        """Connect a board and power it up."""
        built = contract or self.contract
        boards = VirtualBoards(built, 0, {node_id}, new_sampler(built), unnumbered=not numbered)
        return self.connect(boards)

    def connect(self, boards: Boards) -> Place:
        place = Place(boards, self.wire.attach(f"board {len(self.places)}"))
        self.places.append(place)
        self._post(place, boards.power_up(self.now_ns * 1e-9))
        return place

    def commission(
        self, *, stop_after: Callable[[Commissioning], bool] = lambda _: False, **options: bool
    ) -> Commissioning:
        """Run to the end; or stop it before."""

        def send(burst: Frames) -> int:
            return self.wire.submit(self.master, burst, self.now_ns)

        run = Commissioning(self.contract, 0, send, self.now_s, **options)
        while not run.done:
            self._step(run)
            if not run.done and stop_after(run):
                run.give_up()
        return run

    def is_configured(self, place: int) -> bool:
        """Tell whether a board is in the state LSS configuration: nothing but its LED shows it."""
        return self.places[place].boards._boards[0].slave.is_configured

    @property
    def now_s(self) -> float:
        return self.now_ns * 1e-9

    def _step(self, run: Commissioning) -> None:
        due_ns = [self.now_ns + 20_000_000, self.wire.next_event_ns() or 2**62]
        due_ns += [round(run.due_s * 1e9) + 1] if run.due_s > self.now_s else []
        due_ns += [round(each.boards.due_s * 1e9) for each in self.places if self.now_s < each.boards.due_s < 1e9]
        self.now_ns = max(min(due_ns), self.now_ns + 1000)
        ended = self.wire.run_until(self.now_ns)
        for place in self.places:
            arrived = self._of(ended, place.station)
            for each in arrived:
                if each["can_id"] == 0x7E5:
                    place.is_alive = place.is_alive and place.lives(each["data"][:8].tobytes())
            if place.is_alive and len(arrived):
                self._post(place, place.boards.take(arrived, self.now_s))
            if place.is_alive and self.now_s >= place.boards.due_s:
                self._post(place, place.boards.pass_time(self.now_s))
        run.take(self._of(ended, self.master), self.now_s)
        run.tick(self.now_s)

    def _of(self, ended: Events, station: Station) -> Frames:
        is_own = ended.owner == station.number
        is_mine = ended.audience & np.where(is_own, OWNER, OTHERS) != 0
        came = ended.frames[is_mine].copy()
        came["flags"][is_own[is_mine]] |= ECHO
        return came

    def _post(self, place: Place, burst: Frames) -> None:
        late = burst.copy()
        late["port"] = 0
        late["time_ns"] = self.now_ns + self.random.integers(50_000, SLOWEST_NS)
        self.wire.submit(place.station, late, self.now_ns)


def complete(run: Commissioning) -> set[int]:
    return {node_id for node_id, board in run.boards.items() if board.is_complete}


FOREIGN = {"device": {"first_serial": 1000}}


class DiesBeforeStoring:
    """Loses power when the node-ID that was given last is to be stored, and is `node_id`."""

    def __init__(self, node_id: int) -> None:
        self._node_id, self._given = node_id, 0

    def __call__(self, request: bytes) -> bool:
        self._given = request[1] if request[0] == 0x11 else self._given
        return request[0] != 0x17 or self._given != self._node_id


def check_commissioning(nodes: int, add: Callable[[Bench, int], Place] = Bench.add) -> float:
    """Commission boards: one dies, two have one serial number, one is a stranger; return seconds of the bus."""
    bench = Bench(skin(nodes))
    for node_id in range(1, nodes + 1):
        add(bench, node_id)
    add(bench, 2)
    bench.add(1, contract=skin(nodes, **FOREIGN))
    bench.places[2].lives = DiesBeforeStoring(3)
    started_s = bench.now_s
    run = bench.commission()
    assert complete(run) == set(range(1, nodes + 1)) - {2, 3}
    assert "two boards answer: they have one serial number" in run.boards[2].text
    assert (
        "stopped answering at the storage of its node-ID (so far: has node-ID 3 until its power is cut)"
        in run.boards[3].text
    )
    assert len(run.strangers) == 1
    assert "serial number 1000: not a board of this skin" in run.strangers[0]
    assert not run.is_whole
    return bench.now_s - started_s
