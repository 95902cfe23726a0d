"""Boards in C and nodes in Python that get the same frames and taxels."""

import shutil
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from dbc.canopen import HEARTBEAT_BASE, NMT_COB_ID, SDO_REQUEST_BASE, SYNC_COB_ID
from dbc.contract import Contract
from dbc.frame import Frames
from nodes.electronics import Electronics
from nodes.firmware.library import Firmware
from nodes.sampler import CountSampler
from nodes.segment import Segment
from nodes.sending import sending_of
from nodes.virtual_boards import VirtualBoards
from skin.sources import Frame, TaxelSource
from tests import layouts
from tests.bus.harness import frame
from tests.nodes.helpers import ArrayLink, read_request, write_request

needs_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="NOT TESTED: no C compiler")
small_contract = partial(layouts.small_contract, rate_hz=100.0)


def analogue(sum_bits: int = 12, adc_bits: int = 12, **tables: Any) -> Contract:
    """Return boards with a converter of `adc_bits` for each sum; `tables` are those of the file besides."""
    taxels = {"frontend": "analogue", "adc_bits": adc_bits}
    return small_contract(**{"taxels": taxels, "encoding": {"sum_bits": sum_bits}} | tables)


def few_sums(bus: list[dict[str, Any]], turns: int = 1) -> Contract:
    """Three sums of four blocks: one block has none."""
    return small_contract(turns=turns, bus=bus, measurement={"sums": 3})


class Rolling:
    """A source whose taxels are drawn anew in every step, with many at both ends of the range."""

    has_noise = True

    def __init__(self, contract: Contract) -> None:
        self._taxels = contract.layout.taxels

    def frame(self, step: int) -> Frame:
        shape = (self._taxels.rows, self._taxels.columns)
        force_n = np.random.default_rng(step).uniform(-0.3, 1.3, shape) * self._taxels.force_max_n
        return Frame(np.clip(force_n, 0, None).astype(np.float32), "")


class CountWitness(CountSampler):
    """A sampler that remembers the sums of the counts that it gave to the boards, by the time of the SYNC."""

    def __init__(self, contract: Contract) -> None:
        layout = contract.layout
        electronics = Electronics(layout.taxels, noise_n=0.0, period_s=layout.sync.period_s)
        super().__init__(contract.phi, Rolling(contract), electronics)
        self._half_ns = 0.5e9 * layout.sync.period_s
        self.truths: dict[int, npt.NDArray[np.int32]] = {}

    def sample(self, counter: int, time_ns: int, bus: int = 0) -> npt.NDArray[np.int32]:
        counts = super().sample(counter, time_ns, bus)
        self.truths[time_ns] = np.asarray(self._phi.forward(counts[-1]), np.int32)
        return counts

    def sums_at(self, time_ns: int) -> npt.NDArray[np.int32]:
        """Return the sums of the SYNC at a time."""
        nearest = min(self.truths, key=lambda known: abs(known - time_ns))
        assert abs(nearest - time_ns) < self._half_ns, "no board has seen this SYNC"
        return self.truths[nearest]


class Twins:
    """Nodes of one bus twice, in Python (first) and in C (second), and a clock that the test moves.

    Parameters
    ----------
    nodes : int, optional
        How many of the bus; default: all.
    **analogue
        ``noise_n``, ``seed`` and ``defects`` of the sensors.
    """

    def __init__(
        self,
        contract: Contract,
        bus: int = 0,
        *,
        nodes: int | None = None,
        source: TaxelSource | None = None,
        **analogue: Any,
    ) -> None:
        self.contract, self.now_s = contract, 100.0
        self.nodes = contract.on_bus(bus)[:nodes]
        self.ids = {node.node_id for node in self.nodes}
        firmware = Firmware(contract, contract.nodes if nodes is None else self.nodes)  # one library for all buses
        given = [node.block for node in self.nodes], source or Rolling(contract)
        new_hardware = sending_of(contract.layout).hardware
        python, c = (new_hardware(contract, *given, each, **analogue) for each in (None, firmware))
        self.c = firmware.boards(bus)
        boards = VirtualBoards(contract, bus, self.ids, python), self.c
        self.links = ArrayLink(), ArrayLink()
        self.complaints: list[str] = []
        self.segments = tuple(
            Segment(contract, bus, each, hardware, link.send, complain=self.complaints.append)
            for each, hardware, link in zip(boards, (python, c), self.links, strict=True)
        )
        for segment in self.segments:
            segment.boot(self.now_s)

    def put_all(self, burst: Frames) -> None:
        """Send frames to both."""
        for segment in self.segments:
            segment.take(burst.copy(), self.now_s)

    def put(self, can_id: int, data: bytes, flags: int = 0) -> None:
        """Send one frame to both."""
        self.put_all(frame(can_id, data, flags=flags))

    def nmt(self, command: int, node_id: int = 0) -> None:
        """Give an NMT command."""
        self.put(NMT_COB_ID, bytes((command, node_id)))

    def sync(self, counter: int) -> None:
        """Send a SYNC; 0: one without counter."""
        self.put_all(frame(SYNC_COB_ID, bytes((counter,) if counter else ()), time_ns=round(self.now_s * 1e9)))

    def go_on(self, seconds: float, step_s: float = 0.005) -> None:
        """Let time pass."""
        for _ in range(round(seconds / step_s)):
            self.now_s += step_s
            for segment in self.segments:
                segment.tick(self.now_s)

    def answers(self) -> Frames:
        """Return what both sent since the last call, by identifier; raises AssertionError if they differ.

        The heartbeats of stepped boards have their own times, and are left out.
        """
        python, c = (each.take_sent() for each in self.links)
        if self.contract.in_steps:
            python, c = (each[each["can_id"] < HEARTBEAT_BASE] for each in (python, c))
        # The nodes in Python send cyclic PDOs before others, whatever the order of nodes and PDOs.
        python, c = (np.sort(each, order=["can_id", "port", "data"]) for each in (python, c))
        assert [describe(each) for each in c] == [describe(each) for each in python]
        return c

    def ask(self, node_id: int, request: bytes) -> bytes:
        """Return the answer of both to an SDO request."""
        self.put(SDO_REQUEST_BASE + node_id, request.ljust(8, b"\0"))
        data: bytes = self.answers()[-1]["data"][:8].tobytes()
        return data

    def write(self, index: int, subindex: int, data: bytes, node_id: int = 1) -> None:
        """Write an object of both."""
        self.ask(node_id, write_request(index, subindex, data))

    def read(self, index: int, subindex: int = 0, node_id: int = 1) -> bytes:
        """Return an object of up to seven bytes, as both tell it."""
        answer = self.ask(node_id, read_request(index, subindex))
        return self.ask(node_id, b"\x60")[1:] if answer[0] == 0x41 else answer[4:]


def describe(one: np.void) -> tuple[int, ...]:
    """Return all of a frame."""
    return (*(int(one[key]) for key in one.dtype.names if key != "data"), *one["data"][: one["length"]].tolist())
