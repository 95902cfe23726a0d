"""Stock boards through python-can: in the same process, and behind a serial adapter that is unplugged."""

import select
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bus.link import Link, open_link
from bus.python_can import PythonCanLink
from canskin.messages import Measurement
from dbc.contract import Contract
from dbc.frame import ECHO
from gateway.loop import GatewayLoop
from nodes.segment import Segment
from nodes.virtual_boards import VirtualBoards
from tests.bus.serial_adapter import SerialAdapter
from tests.gateway.helpers import Witness, WitnessSampler, valid
from tests.layouts import buses, small_contract
from tests.processes import PATIENCE_S

pytestmark = pytest.mark.heavy
CONTRACT = small_contract(bus=buses(4))


class Skin:
    """A gateway on a link, and boards on the other end, both in real time."""

    def __init__(self, contract: Contract, link: Link, far: Any) -> None:
        layout = contract.layout
        electronics = Witness(layout.taxels, noise_n=0.0, period_s=layout.shortest_period_s)
        self.sampler = WitnessSampler(contract.phi, electronics)
        boards = VirtualBoards(contract, 0, {node.node_id for node in contract.nodes}, self.sampler)
        self._segment = Segment(contract, 0, boards, self.sampler, self._send, complain=print)
        self._link, self._far, self.is_plugged = link, far, True
        self._segment.boot(time.monotonic())
        early = [] if link.proves_echo else [0]
        now_s = time.monotonic()
        self.gateway = GatewayLoop(contract, {0: link.send}, now_s, say=print, complain=print, early_echoes=early)

    def turn(self) -> list[Measurement]:
        select.select([self._link], [], [], 0.002)
        if self.is_plugged:
            arrived = self._far.receive()
            now = arrived["time_ns"] == 0
            arrived["time_ns"][now] = time.monotonic_ns()
            self._segment.take(arrived[arrived["flags"] & ECHO == 0], time.monotonic())
        self._segment.tick(time.monotonic())
        link, take = self._link, self.gateway.take
        arrived = link.receive()
        take(0, arrived, time.monotonic(), state=link.state, dropped=link.dropped, stamp_error_ns=link.stamp_error_ns)
        self.gateway.tick(time.monotonic())
        made = self.gateway.send_sync(time.monotonic()) + self.gateway.measurements(time.monotonic())
        for each in made:
            self.check(each)
        return made

    def check(self, measurement: Measurement) -> None:
        """Check that the valid sums are those of one SYNC."""
        is_valid = valid(measurement)[CONTRACT.phi.block_of_sum]
        sums = np.frombuffer(measurement.sums, "<i4")[is_valid]
        packing, truth = CONTRACT.packing, self.sampler.truths.get((0, measurement.sync_counter))
        assert not len(sums) or (truth is not None and (packing.counts(packing.raw(truth))[is_valid] == sums).all())

    def until_whole(self) -> None:
        """Go on until all blocks are valid."""
        until_s = time.monotonic() + PATIENCE_S
        while not any(valid(each).all() for each in self.turn()):
            assert time.monotonic() < until_s

    def _send(self, burst: Any) -> int:
        return self._far.send(burst) if self.is_plugged else len(burst)


@contextmanager
def opened(*links: Link) -> Iterator[None]:
    try:
        yield
    finally:
        for link in links:
            link.close()


def test_stock_boards_answer_through_the_virtual_interface_of_python_can() -> None:
    near, far = (PythonCanLink("virtual", "stock boards", 1_000_000) for _ in range(2))
    with opened(near, far):
        skin = Skin(CONTRACT, near, far)
        skin.until_whole()
        skin.until_whole()


def test_a_serial_adapter_is_unplugged_and_the_skin_is_whole_again(tmp_path: Path) -> None:
    adapter = SerialAdapter(tmp_path / "ttyACM0")
    link = open_link("slcan", str(adapter.path), 1_000_000, options={"sleep_after_open": 0.0})
    with opened(link):
        skin = Skin(CONTRACT, link, adapter)
        skin.until_whole()
        for _ in range(2):
            replug(skin, adapter, link)
            skin.until_whole()
    adapter.unplug()


def replug(skin: Skin, adapter: SerialAdapter, link: Link) -> None:
    """Unplug the adapter until the link has found out, and plug it in again."""
    before = link.dropped
    skin.is_plugged = False
    adapter.unplug()
    while link.dropped == before:
        skin.turn()
    adapter.plug()
    skin.is_plugged = True
