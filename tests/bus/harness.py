"""Frames to send, a bus served by a thread of the test, and waiting that ends."""

import select
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np

from bus.interface import Controller, Interface, Mode, Timing
from bus.link import Link, State, open_link
from bus.server import BusServer, BusSettings
from dbc.frame import Frames, frames
from tests.processes import PATIENCE_S


def frame(can_id: int, data: bytes = b"", flags: int = 0, *, port: int = 0, time_ns: int = 0) -> Frames:
    one = frames(1)
    one["can_id"], one["length"], one["flags"], one["port"], one["time_ns"] = can_id, len(data), flags, port, time_ns
    one["data"][0, : len(data)] = np.frombuffer(data, np.uint8)
    return one


def burst(ids: Sequence[int], length: int = 8) -> Frames:
    many = frames(len(ids))
    many["can_id"] = ids
    many["length"] = length
    many["data"][:, :length] = np.random.default_rng(len(ids)).integers(0, 256, (len(ids), length))
    return many


@contextmanager
def serving(*channels: str, **settings: Any) -> Iterator[BusServer]:
    stop = threading.Event()
    with BusServer(channels, BusSettings(**settings)) as server:
        thread = threading.Thread(target=server.serve, args=(stop.is_set,))
        thread.start()
        try:
            yield server
        finally:
            stop.set()
            thread.join(PATIENCE_S)
            assert not thread.is_alive()


@contextmanager
def linked(*names: str, channel: str = "bus0", **options: Any) -> Iterator[list[Link]]:
    links = [open_link("canskin", channel, 1_000_000, name=name, wait_s=PATIENCE_S, **options) for name in names]
    try:
        yield links
    finally:
        for link in links:
            link.close()


def collect(link: Link, count: int) -> Frames:
    """Receive until `count` records are there."""
    until = time.monotonic() + PATIENCE_S
    arrived = [frames(0)]
    while sum(map(len, arrived)) < count:
        assert time.monotonic() < until, f"{sum(map(len, arrived))} of {count} records came"
        select.select([link], [], [], 0.1)
        arrived.append(link.receive())
    return np.concatenate(arrived)


def await_state(link: Link, state: int) -> None:
    until = time.monotonic() + PATIENCE_S
    while link.state != state:
        assert time.monotonic() < until, f"state {link.state} instead of {state}"
        select.select([link], [], [], 0.05)
        link.receive()


def interface(**changed: Any) -> Interface:
    """Return an interface without faults, except for what is changed, of it or of its controller."""
    device = Controller(Timing(1_000_000, 0.75), None, State.ACTIVE, Mode(0), 100, None)
    ours = {name: changed.pop(name) for name in list(changed) if hasattr(device, name)}
    return replace(Interface("can", True, True, 16, 10, replace(device, **ours)), **changed)
