"""Cycles on a real kernel: a SYNC's echo stands before every answer to it, and late answers are never used."""

import select
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from bus.link import Link, open_link
from dbc.canopen import HEARTBEAT_BASE, SYNC_COB_ID
from dbc.contract import Contract, sync_frame
from dbc.frame import ECHO, Frames, frames
from skin.layout import load_layout
from tests.bus.harness import frame
from tests.layouts import TURNS, slow_layout
from tests.processes import PATIENCE_S, Processes
from tests.vcan.chain import RATE_HZ, complete, running_chain, valid

CYCLES = 60
TPDO_FIRST, TPDO_LAST = 0x181, 0x57F


@pytest.fixture
def links() -> Iterator[tuple[Link, Link]]:
    """Return the master's link and one that only listens."""
    opened = [open_link("socketcan", "vcan0", 1_000_000) for _ in range(2)]
    yield opened[0], opened[1]
    for link in opened:
        link.close()


@pytest.fixture(params=TURNS)
def bus0(request: pytest.FixtureRequest, tmp_path: Path, links: tuple[Link, Link]) -> Iterator[Contract]:
    """Run the 32 nodes of one bus; wait for their boot-up messages."""
    path = slow_layout(tmp_path, RATE_HZ, request.param)
    with Processes(tmp_path) as processes:
        common = ("-i", "socketcan", "-c", "vcan0", "--layout", str(path))
        processes.skin("nodes", "nodes", *common, "--only", "bus0:1-32", "--no-fabric")
        booted: set[int] = set()

        def all_there() -> bool:
            arrived = links[0].receive()
            booted.update(
                arrived["can_id"][(arrived["can_id"] > HEARTBEAT_BASE) & (arrived["data"][:, 0] == 0)].tolist()
            )
            return len(booted) == 32

        processes.until(all_there, "32 boot-up messages")
        yield Contract.from_layout(load_layout(path))


def drive(master: Link, contract: Contract) -> Frames:
    """Send SYNCs, each when all answers to the last have come; return the stream."""
    stream, table = [frames(0)], contract.table
    for counter in range(1, CYCLES + 1):
        master.send(sync_frame(counter))
        due = int(((table.bus == 0) & (table.turn == contract.turn_of(counter))).sum())
        until_s = time.monotonic() + PATIENCE_S
        answers = 0
        while answers < due:
            assert time.monotonic() < until_s, f"{answers} answers to SYNC {counter}"
            select.select([master], [], [], 0.1)
            stream.append(master.receive())
            answers += int(is_tpdo(stream[-1]).sum())
    return np.concatenate(stream)


def is_tpdo(stream: Frames) -> np.ndarray:
    return (stream["can_id"] >= TPDO_FIRST) & (stream["can_id"] <= TPDO_LAST)


def since_start(stream: Frames) -> Frames:
    return stream[np.flatnonzero(stream["can_id"] == 0x000)[0] :]


def test_the_echo_of_a_sync_stands_before_its_answers(bus0: Contract, links: tuple[Link, Link]) -> None:
    master, listener = links
    assert master.proves_echo
    table = bus0.table
    of_bus = table.bus == 0
    master.send(frame(0x000, bytes((1, 0))))  # start all nodes
    stream = drive(master, bus0)

    sent = stream["flags"] & ECHO != 0
    assert stream["can_id"][sent].tolist() == [0x000] + [SYNC_COB_ID] * CYCLES
    syncs = np.flatnonzero(sent & (stream["can_id"] == SYNC_COB_ID))
    counters = list(range(1, CYCLES + 1))
    assert stream["data"][syncs, 0].tolist() == counters
    assert not is_tpdo(stream[: syncs[0]]).any()
    for counter, place, end in zip(counters, syncs, [*syncs[1:], len(stream)], strict=True):
        answers = stream[place + 1 : end]
        wanted = table.cob_id[of_bus & (table.turn == bus0.turn_of(counter))]
        assert sorted(answers["can_id"][is_tpdo(answers)].tolist()) == sorted(wanted.tolist())
        assert set(answers["data"][is_tpdo(answers), 0].tolist()) == {counter}

    heard = listener.receive()
    assert not (heard["flags"] & ECHO).any()
    heard, stream = (since_start(each) for each in (heard, stream))
    heard = heard[: len(stream)]
    for field in ("can_id", "length", "data"):
        assert np.array_equal(heard[field], stream[field]), "two sockets saw different orders"


def test_whatever_nodes_answer_late_every_valid_block_is_of_its_cycle(tmp_path: Path) -> None:
    """The nodes' process stands still for a part of a cycle, for one and for several, and then answers every SYNC."""
    compared = 0
    with running_chain(tmp_path) as chain:
        first = len(chain.measurements)
        for periods in (0.4, 0.8, 1.1, 1.5, 2.3, 3.2):
            before = len(chain.measurements)
            chain.processes.send_signal("nodes", signal.SIGSTOP)
            time.sleep(periods / RATE_HZ)
            chain.processes.send_signal("nodes", signal.SIGCONT)
            if periods > 2:  # at least one SYNC is answered later than the next one
                chain.processes.until(
                    lambda before=before: not all(map(complete, chain.measurements[before:])), "a cycle marked as hurt"
                )
            chain.await_known(1)
        chain.await_known(10)
        for each in chain.measurements[first:]:
            truth = chain.truth_of(each)
            if truth is None:
                continue  # the fabric had no room for it, or no node has sampled in this cycle
            compared += 1
            wanted = chain.phi.sums_of_blocks(valid(each))
            assert np.array_equal(np.frombuffer(each.sums, "<i4")[wanted], chain.true_sums(each)[wanted])
    assert compared >= 10
