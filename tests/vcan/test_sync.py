"""A master of our own on a real kernel: in its stream, a SYNC's echo stands before every answer to it."""

import select
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from bus.link import Link, open_link
from dbc.canopen import HEARTBEAT_BASE, SYNC_COB_ID
from dbc.contract import Contract, phase_of
from dbc.frame import ECHO, Frames, frames
from skin.layout import load_layout
from tests.processes import PATIENCE_S, Processes

CYCLES = 60
TPDO_FIRST, TPDO_LAST = 0x181, 0x57F


def one(can_id: int, data: bytes) -> Frames:
    frame = frames(1)
    frame["can_id"], frame["length"] = can_id, len(data)
    frame["data"][0, : len(data)] = tuple(data)
    return frame


@pytest.fixture
def links() -> Iterator[tuple[Link, Link]]:
    """Return the master's link and one that only listens."""
    opened = [open_link("socketcan", "vcan0", 1_000_000) for _ in range(2)]
    yield opened[0], opened[1]
    for link in opened:
        link.close()


@pytest.fixture
def bus0(tmp_path: Path, links: tuple[Link, Link]) -> Iterator[None]:
    """Run the 32 nodes of one bus; wait for their boot-up messages."""
    with Processes(tmp_path) as processes:
        processes.skin("nodes", "nodes", "-i", "socketcan", "-c", "vcan0", "--only", "bus0:1-32", "--no-fabric")
        booted: set[int] = set()

        def all_there() -> bool:
            arrived = links[0].receive()
            booted.update(
                arrived["can_id"][(arrived["can_id"] > HEARTBEAT_BASE) & (arrived["data"][:, 0] == 0)].tolist()
            )
            return len(booted) == 32

        processes.until(all_there, "32 boot-up messages")
        yield


def drive(master: Link, rows_of_phase: int) -> Frames:
    """Send SYNCs, each when all answers to the last have come; return the stream."""
    stream = [frames(0)]
    for counter in range(1, CYCLES + 1):
        master.send(one(SYNC_COB_ID, bytes((counter,))))
        until_s = time.monotonic() + PATIENCE_S
        answers = 0
        while answers < rows_of_phase:
            assert time.monotonic() < until_s, f"{answers} answers to SYNC {counter}"
            select.select([master], [], [], 0.1)
            stream.append(master.receive())
            answers += int(is_tpdo(stream[-1]).sum())
    return np.concatenate(stream)


def is_tpdo(stream: Frames) -> np.ndarray:
    return (stream["can_id"] >= TPDO_FIRST) & (stream["can_id"] <= TPDO_LAST)


def since_start(stream: Frames) -> Frames:
    return stream[np.flatnonzero(stream["can_id"] == 0x000)[0] :]


@pytest.mark.usefixtures("bus0")
def test_the_echo_of_a_sync_stands_before_its_answers(links: tuple[Link, Link]) -> None:
    master, listener = links
    table = Contract.from_layout(load_layout()).table
    of_bus = table.bus == 0
    master.send(one(0x000, bytes((1, 0))))  # start all nodes
    stream = drive(master, int((of_bus & (table.phase == 0)).sum()))

    sent = stream["flags"] & ECHO != 0
    assert stream["can_id"][sent].tolist() == [0x000] + [SYNC_COB_ID] * CYCLES
    syncs = np.flatnonzero(sent & (stream["can_id"] == SYNC_COB_ID))
    assert stream["data"][syncs, 0].tolist() == list(range(1, CYCLES + 1))
    assert not is_tpdo(stream[: syncs[0]]).any()
    for place, end in zip(syncs, [*syncs[1:], len(stream)], strict=True):
        answers = stream[place + 1 : end]
        wanted = table.cob_id[of_bus & (table.phase == phase_of(int(stream["data"][place, 0])))]
        assert sorted(answers["can_id"][is_tpdo(answers)].tolist()) == sorted(wanted.tolist())

    heard = listener.receive()
    assert not (heard["flags"] & ECHO).any()
    heard, stream = (since_start(each) for each in (heard, stream))
    heard = heard[: len(stream)]
    for field in ("can_id", "length", "data"):
        assert np.array_equal(heard[field], stream[field]), "two sockets saw different orders"
