"""Boards in C and nodes in Python that get the same frames and taxels."""

import shutil
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from dbc.canopen import SYNC_COB_ID
from dbc.contract import Contract
from dbc.frame import Frames, frames
from nodes.electronics import Electronics
from nodes.firmware.library import Firmware
from nodes.sampler import CountSampler, new_sampler
from nodes.segment import Segment
from nodes.virtual_boards import VirtualBoards
from skin.sources import Frame, TaxelSource
from tests import layouts
from tests.bus.harness import frame

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


class Wire:
    """Keeps what is sent."""

    def __init__(self) -> None:
        self.sent: list[Frames] = []
        self.room = 1 << 30

    def send(self, burst: Frames) -> int:
        self.sent.append(burst[: self.room].copy())
        return len(self.sent[-1])

    def take(self) -> list[tuple[int, int, bytes]]:
        """Return identifier, flags and data of what was sent."""
        taken = [each for burst in self.sent for each in burst]
        self.sent.clear()
        return [(int(each["can_id"]), int(each["flags"]), each["data"][: each["length"]].tobytes()) for each in taken]


class Twins:
    """The nodes of one bus twice: in Python and in C."""

    def __init__(
        self, contract: Contract, bus: int = 0, noise_n: float = 0.0, source: TaxelSource | None = None
    ) -> None:
        self.contract = contract
        self.now_s = 100.0
        self.wires = Wire(), Wire()
        self.complaints: list[str] = []
        self.nodes = contract.on_bus(bus)
        sums, readings = (
            new_sampler(
                contract.layout, contract.phi, source or Rolling(contract), makes_sums=makes_sums, noise_n=noise_n
            )
            for makes_sums in (True, False)
        )
        virtual = VirtualBoards(contract, bus, {node.node_id for node in self.nodes}, sums)
        compiled = Firmware(contract, contract.nodes).boards(bus)  # one library for all buses
        complain = self.complaints.append
        self.python = Segment(contract, bus, virtual, sums, self.wires[0].send, complain=complain)
        self.c = Segment(contract, bus, compiled, readings, self.wires[1].send, complain=complain)
        self.segments = self.python, self.c
        for segment in self.segments:
            segment.boot(self.now_s)

    def put(self, can_id: int, data: bytes, flags: int = 0) -> None:
        """Send one frame to both."""
        self.put_all(frame(can_id, data, flags=flags))

    def put_all(self, burst: Frames) -> None:
        """Send frames to both."""
        for segment in self.segments:
            segment.take(burst.copy(), self.now_s)

    def sync(self, counter: int) -> None:
        """Send a SYNC; 0: one without counter."""
        self.put_all(frame(SYNC_COB_ID, bytes((counter,) if counter else ()), time_ns=round(self.now_s * 1e9)))

    def go_on(self, seconds: float, step_s: float = 0.005) -> None:
        """Let time pass."""
        for _ in range(round(seconds / step_s)):
            self.now_s += step_s
            for segment in self.segments:
                segment.tick(self.now_s)

    def answers(self) -> list[tuple[int, int, bytes]]:
        """Return what both sent since the last call; raises AssertionError if they differ."""
        # The Python nodes send cyclic PDOs before others, whatever the order of nodes and PDOs.
        python, c = (sorted(wire.take()) for wire in self.wires)
        assert c == python
        return c


def windows(twins: Twins) -> Iterator[tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]]:
    """Return earliest and latest start of the frames that each twin has sent."""
    for wire in twins.wires:
        burst = np.concatenate(wire.sent) if wire.sent else frames(0)
        yield burst["time_ns"], burst["expires_ns"]
