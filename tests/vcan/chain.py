"""Nodes and gateway as two processes on vcan0 to vcan3, and what they publish."""

import subprocess
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from canskin.fabric import Fabric
from canskin.messages import GATEWAY, MEASUREMENT, TRUTH, GatewayStatus, Measurement, Truth
from dbc.packing import packing
from skin.ground_truth import of_one_cycle
from skin.layout import Layout, load_layout
from tests.layouts import slow_layout
from tests.processes import Processes, free_endpoint

#: A rate that a guest kernel on one slow processor carries.
RATE_HZ: Final = 5


class Chain:
    """All messages of a running skin, in the order they came."""

    def __init__(self, layout: Layout, path: Path, processes: Processes, fabric: Fabric) -> None:
        self.layout = layout
        self.path = path
        self.phi = layout.phi()
        self.processes = processes
        self.measurements: list[Measurement] = []
        self.truths: deque[Truth] = deque(maxlen=200)
        self.statuses: list[GatewayStatus] = []
        fabric.subscribe(MEASUREMENT, self.measurements.append)
        fabric.subscribe(GATEWAY, self.statuses.append)
        fabric.subscribe(TRUTH, self.truths.append)

    def await_cycles(self, count: int) -> list[Measurement]:
        """Return the next `count` measurements."""
        first = len(self.measurements)
        self.processes.until(lambda: len(self.measurements) >= first + count, f"{count} measurements")
        return self.measurements[first : first + count]

    def await_known(self, count: int) -> list[Measurement]:
        """Wait for `count` complete measurements whose truth came too; return them.

        A slow guest loses both: frames late for their cycle, and truths that the fabric had no room for.
        """
        first = len(self.measurements)

        def known() -> list[Measurement]:
            return [each for each in self.measurements[first:] if complete(each) and self.truth_of(each)]

        self.processes.until(lambda: len(known()) >= count, f"{count} complete measurements with their truths")
        return known()

    def await_complete(self, in_a_row: int = 3) -> None:
        """Wait until the newest measurements are complete."""
        self.processes.until(
            lambda: len(self.measurements) >= in_a_row and all(map(complete, self.measurements[-in_a_row:])),
            f"{in_a_row} complete measurements in a row",
        )

    def await_valid(self, wanted: npt.NDArray[np.bool_], in_a_row: int = 3) -> None:
        """Wait until exactly the `wanted` blocks are valid in the newest measurements."""
        self.processes.until(
            lambda: (
                len(self.measurements) >= in_a_row
                and all(np.array_equal(valid(each), wanted) for each in self.measurements[-in_a_row:])
            ),
            f"{wanted.sum()} valid blocks",
        )

    def blocks_of(self, bus: int) -> npt.NDArray[np.bool_]:
        """Return which blocks are on bus number `bus`."""
        first = self.layout.first_block(bus)
        blocks = np.arange(self.layout.blocks)
        return (blocks >= first) & (blocks < first + self.layout.bus[bus].nodes)

    def true_sums(self, measurement: Measurement) -> npt.NDArray[np.int32]:
        """Return the sums of what the nodes say their taxels showed at the SYNC of a measurement, rounded as sent."""
        truth = self.truth_of(measurement)
        assert truth is not None, f"no truth of cycle {measurement.cycle}"
        felt_n = np.frombuffer(truth.sensor, "<f4")
        counts = np.rint(felt_n / self.layout.taxels.newton_per_count).astype(np.int32)
        carried = packing(self.layout)
        return carried.counts(carried.raw(np.asarray(self.phi.forward(counts), np.int32)))

    def truth_of(self, measurement: Measurement) -> Truth | None:
        """Return the truth of the cycle of a measurement, None if it has not come."""
        period_s = self.layout.sync.period_s
        return next((each for each in reversed(self.truths.copy()) if of_one_cycle(measurement, each, period_s)), None)


def valid(measurement: Measurement) -> npt.NDArray[np.bool_]:
    return np.frombuffer(measurement.valid, np.uint8) == 1


def complete(measurement: Measurement) -> bool:
    return bool(valid(measurement).all())


@contextmanager
def running_chain(folder: Path, path: Path | None = None, gateway: Sequence[str] = ("vcan0",)) -> Iterator[Chain]:
    """Start the nodes on vcan0 and the next, then the gateway on the same; wait for the first complete measurements.

    Without `path` it is the default skin on four buses; `gateway` are other interfaces of the gateway.
    """
    path = path or slow_layout(folder, RATE_HZ)
    layout = load_layout(path)
    endpoint = free_endpoint()
    fabric = Fabric(layout.name, "test", endpoint, hub=True)
    try:
        with Processes(folder) as processes:
            alive: set[str] = set()
            fabric.watch(lambda name, there: alive.add(name) if there else alive.discard(name))
            chain = Chain(layout, path, processes, fabric)
            common = ("-i", "socketcan", "--layout", str(path), "--connect", endpoint)
            processes.skin("nodes", "nodes", *common, "-c", "vcan0")
            processes.until(lambda: "nodes" in alive, "the nodes")
            processes.skin("gateway", "gateway", *common, "-c", *gateway)
            chain.await_complete()
            yield chain
    finally:
        fabric.close()


def ip_link(*arguments: str) -> None:
    """Change a network interface."""
    subprocess.run(["ip", "link", *arguments], check=True)
