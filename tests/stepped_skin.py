"""Stepped nodes and their gateway as processes, and a touch that rests: then no sum changes any more."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import numpy.typing as npt

from canskin.fabric import Fabric
from canskin.messages import GATEWAY, MEASUREMENT, BlockState, GatewayStatus, Measurement
from dbc.contract import Contract
from skin.layout import Layout, load_layout
from skin.walsh import grouped_rows, walsh_matrix
from tests.layouts import STEPPED, buses, layout_toml
from tests.processes import Processes, free_endpoint

LAYOUT = layout_toml(16, 32, **STEPPED, name="rest", bus=buses(8, 8, names=("left", "right")))
#: Measurements in a row with the same sums, ten a second: longer than the longest refresh.
AT_REST = 15
#: Recorded value of the skin's full scale.
FULL_SCALE = 4095


class RestingSkin:
    """The newest measurement of nodes and gateway as processes."""

    def __init__(self, layout: Layout, processes: Processes, fabric: Fabric, arguments: tuple[str, ...]) -> None:
        self.contract = Contract.from_layout(layout)
        self.measurements: list[Measurement] = []
        self.statuses: list[GatewayStatus] = []
        self._processes = processes
        self._arguments = arguments
        self._touch = processes.folder / "touch.npy"
        fabric.subscribe(MEASUREMENT, self.measurements.append)
        fabric.subscribe(GATEWAY, self.statuses.append)
        rows, columns = np.mgrid[0:16, 0:32]
        self._played = np.round(3000 * np.exp(-((rows - 6) ** 2 + (columns - 14) ** 2) / 30)).astype("u2")
        np.save(self._touch, self._played[None])

    def start_bus(self) -> None:
        """Start a virtual bus, for services without options of a CAN interface."""
        self._processes.skin("bus", "bus", *(bus.name for bus in self.contract.layout.bus))
        self._processes.await_words("bus", "left")

    def start(self, name: str, *more: str) -> None:
        """Start nodes or gateway, with more options."""
        touch = ("--input", str(self._touch), "--full-scale", str(FULL_SCALE)) if name == "nodes" else ()
        self._processes.skin(name, name, *self._arguments, *touch, *more)

    @property
    def true_n(self) -> npt.NDArray[np.float64]:
        """The sums of the touch in the order of the frames, shape (nodes, sums)."""
        force_n = self._played.ravel() * (self.contract.layout.taxels.force_max_n / FULL_SCALE)
        of_blocks = force_n[self.contract.phi.taxels_of_blocks]
        return np.asarray(of_blocks @ walsh_matrix(of_blocks.shape[1]).T)

    def kill(self, name: str) -> None:
        self._processes.stop(name, signal.SIGKILL)

    def await_rest(self) -> npt.NDArray[np.float64]:
        """Wait until every block is valid and no sum changes any more; return the sums in the order of the frames."""
        self.measurements.clear()
        self._processes.until(self._rests, "all blocks to be valid and at rest", every_s=0.1)
        sums = np.frombuffer(self.measurements[-1].sums, "<i4").reshape(len(self.contract.nodes), -1)
        newton_per_count = self.contract.layout.taxels.newton_per_count
        return np.asarray(sums[:, grouped_rows(sums.shape[1]).ravel()] * newton_per_count)

    def await_states(self, wanted: BlockState) -> None:
        def all_are() -> bool:
            return bool(self.measurements) and set(self.measurements[-1].states) == {wanted}

        self._processes.until(all_are, f"all blocks to be {wanted.name}")

    def _rests(self) -> bool:
        newest = self.measurements[-AT_REST:]
        return len(newest) == AT_REST and all(
            all(each.valid) and each.sums == newest[0].sums and any(each.sums) for each in newest
        )

    def is_true(self, held_n: npt.NDArray[np.float64]) -> bool:
        """Tell whether sums are those of the touch, but for a count of each taxel."""
        rounding_n = self.true_n.shape[1] * self.contract.layout.taxels.newton_per_count
        return bool((np.abs(held_n - self.true_n) <= self.unsent_n + rounding_n).all())

    @property
    def unsent_n(self) -> float:
        """What of a sum at rest is not worth a frame."""
        return 8 * self.contract.unit_n


@contextmanager
def resting_skin(folder: Path, *options: str) -> Iterator[RestingSkin]:
    """Give a skin whose services, yet to be started, get `options`."""
    path = folder / "rest.toml"
    path.write_text(LAYOUT)
    endpoint = free_endpoint()
    fabric = Fabric("rest", "test", endpoint, hub=True)
    try:
        with Processes(folder) as processes:
            arguments = (*options, "--layout", str(path), "--connect", endpoint)
            yield RestingSkin(load_layout(path), processes, fabric, arguments)
    finally:
        fabric.close()
