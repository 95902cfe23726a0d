"""The nodes' turn of input and output, with a clock that the test moves."""

import os
import socket
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from bus.link import State
from canskin.messages import NodesStatus, Truth
from dbc import indices as od
from dbc.contract import Contract
from dbc.frame import Frames
from nodes.sampler import Sampler
from nodes.service import STATUS_PERIOD_S, NodesService
from nodes.steps.boards import SteppedBoards
from skin.layout import load_layout
from tests.bus.harness import frame
from tests.messages import Published
from tests.nodes.helpers import MILLISECOND_NS, START, ArrayLink, Still, new_sampler, sync


class ReadyLink(ArrayLink):
    """An `ArrayLink` with a descriptor that tells when the test has put frames in."""

    dropped = 0
    state = State.ACTIVE

    def __init__(self) -> None:
        super().__init__()
        self._near, self._far = socket.socketpair()

    def fileno(self) -> int:
        return self._near.fileno()

    def put(self, *arrived: Frames) -> None:
        self.waiting.extend(arrived)
        self._far.send(b"!")

    def receive(self) -> Frames:
        self._near.recv(4096)
        return super().receive()

    def close(self) -> None:
        self._near.close()
        self._far.close()


class Run:
    """A service whose nodes are operational, with the clock and the messages published."""

    def __init__(
        self, contract: Contract, links: dict[int, ReadyLink], ids: dict[int, set[int]], boards: Sampler | SteppedBoards
    ) -> None:
        self.now_s = 100.0
        self.published = Published()
        self.service = NodesService(contract, links, ids, boards, self.published, clock=lambda: self.now_s)
        for segment in self.service.segments.values():
            segment.boot(self.now_s)
            segment.take(frame(0, bytes((START, 0))), self.now_s)
        for link in links.values():
            link.take_sent()

    def turn(self, after_s: float = 0.0) -> None:
        self.now_s += after_s
        self.service.turn()

    def newest_status(self) -> NodesStatus:
        self.service.publish_status()
        newest: NodesStatus = self.published.of(NodesStatus)[-1]
        return newest


@pytest.fixture
def links() -> Iterator[dict[int, ReadyLink]]:
    made = {bus: ReadyLink() for bus in (0, 1)}
    yield made
    for link in made.values():
        link.close()


def test_frames_of_every_bus_are_answered_and_counted(contract: Contract, links: dict[int, ReadyLink]) -> None:
    now_s = 100.0
    published = Published()
    sampler = new_sampler(contract)
    service = NodesService(contract, links, {0: {1}, 1: {2}}, sampler, published, clock=lambda: now_s)
    for segment in service.segments.values():
        segment.boot(now_s)
    assert [link.take_sent()["can_id"].tolist() for link in links.values()] == [[0x701], [0x702]]
    service.turn()
    assert len(published.of(NodesStatus)) == 1
    links[0].put(frame(0, bytes((START, 0))))
    links[1].put(frame(0, bytes((START, 0))))
    service.turn()
    links[1].put(sync(1))
    service.turn()
    assert len(links[0].take_sent()) == 0
    assert links[1].take_sent()["can_id"].tolist() == [0x182, 0x282]
    assert [truth.sampled_mono_ns for truth in published.of(Truth)] == [10_000_000]
    assert len(published.of(NodesStatus)) == 1
    now_s += STATUS_PERIOD_S
    service.turn()
    assert len(published.of(Truth)) == 1
    newest = published.of(NodesStatus)[-1]
    assert (newest.frames_sent, newest.frames_dropped, newest.syncs_seen) == (2, 0, 1)
    assert np.frombuffer(published.of(Truth)[0].true, "<f4").size == contract.layout.taxels.count


def test_stepped_nodes_turn_once_for_each_sample(links: dict[int, ReadyLink]) -> None:
    contract = Contract.from_layout(load_layout(Path("steps")))
    blocks = [contract.on_bus(bus)[0].block for bus in links]
    boards = SteppedBoards(contract, blocks, Still(contract))
    run = Run(contract, links, {0: {1}, 1: {1}}, boards)
    run.turn()
    assert [len(link.take_sent()) for link in links.values()] == [0, 0]  # there is no SYNC yet
    for link in links.values():
        link.put(frame(0x80, b"\1", time_ns=100_000 * MILLISECOND_NS))
    for _ in range(30):
        run.turn(1e-3)
        for link in links.values():
            link.put()
    assert [truth.step for truth in run.published.of(Truth)] == [1, 2, 3]
    # Slots of 4 ms, that of the SYNC, too.
    assert [link.take_sent()["can_id"].tolist().count(0x181) for link in links.values()] == [8, 8]
    newest = run.newest_status()
    assert newest.frames_sent == sum(segment.frames_sent for segment in run.service.segments.values()) > 0
    assert (newest.frames_dropped, newest.syncs_seen) == (0, 1)
    boards.adjust(blocks[0], od.REFRESH, 0, 1)
    run.turn(5e-3)
    assert boards.is_sending
    for link in links.values():
        link.put()
    run.turn(1e-6)
    assert not boards.is_sending


class StopAfter:
    """A signal that comes after a number of turns, and then calls `last`."""

    def __init__(self, turns: int, last: Callable[[], None] = lambda: None) -> None:
        self._left, self._last = turns, last

    def is_set(self) -> bool:
        self._left -= 1
        if self._left < 0:
            self._last()
        return self._left < 0


def test_last_echoes_are_read_before_the_last_status(links: dict[int, ReadyLink]) -> None:
    contract = Contract.from_layout(load_layout(Path("steps")))
    now_s, published = 100.0, Published()
    block = contract.on_bus(0)[0].block
    boards = SteppedBoards(contract, [block], Still(contract))
    service = NodesService(contract, {0: links[0]}, {0: {1}}, boards, published, clock=lambda: now_s)
    links[0].put(frame(0, bytes((START, 0))), frame(0x80, b"\1", time_ns=round(now_s * 1e9)))
    service.run(StopAfter(1, links[0].put))  # type: ignore[arg-type]
    assert not boards.is_sending
    assert [status.frames_sent for status in published.of(NodesStatus)] == [0, 1]


def test_the_next_cycle_is_sampled_ahead_when_all_buses_have_had_their_answers(
    contract: Contract, links: dict[int, ReadyLink]
) -> None:
    prepared = []
    sampler = new_sampler(contract)
    run = Run(contract, links, {0: {1}, 1: {1}}, sampler)
    sampler.prepare = lambda: prepared.append(run.now_s)  # type: ignore[method-assign]
    links[0].put(sync(1))
    run.turn()
    prepared.clear()
    links[1].put(sync(1))
    run.turn(0.0029)  # of 10 ms
    run.turn(0.0029)
    assert not prepared
    run.turn(0.0002)
    assert prepared == [run.now_s]


def test_on_a_single_bus_the_next_cycle_is_sampled_ahead_at_once(
    contract: Contract, links: dict[int, ReadyLink]
) -> None:
    prepared = []
    sampler = new_sampler(contract)
    sampler.prepare = lambda: prepared.append(sampler.sums)  # type: ignore[method-assign]
    run = Run(contract, {0: links[0]}, {0: {1}}, sampler)
    before = sampler.sums
    links[0].put(sync(1))
    run.turn()
    assert prepared[-1] is sampler.sums is not before  # after the answer


def test_the_status_tells_of_all_buses(contract: Contract, links: dict[int, ReadyLink]) -> None:
    run = Run(contract, links, {0: {1, 2}, 1: {2}}, new_sampler(contract))
    links[0].room = 3
    for each in (links[0], links[0], links[1]):
        each.put(sync(1))
        run.turn()
    newest = run.newest_status()
    assert (newest.frames_sent, newest.frames_dropped, newest.syncs_seen) == (2 * 3 + 2, 2 * 1, 2)
    assert newest.process == str(os.getpid())
