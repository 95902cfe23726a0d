"""Adaptive nodes and their gateway on a real kernel: what the gateway holds is what the nodes would send."""

import signal
import struct
from collections.abc import Iterator
from pathlib import Path

import canopen
import numpy as np
import numpy.typing as npt
import pytest

from canskin.fabric import Fabric
from canskin.messages import GATEWAY, MEASUREMENT, BlockState, GatewayStatus, Measurement
from dbc.adaptive import GROUP_SUMS, OTHER_CODES, coarse_step, coarse_value
from dbc.contract import Contract
from dbc.indices import OD_COARSE
from skin.layout import Layout, load_layout
from skin.walsh import grouped_rows
from tests.processes import Processes, free_endpoint

LAYOUT = """
name = "rest"
sending = "adaptive"
[taxels]
rows = 16
columns = 32
[measurement]
wiring = "board"
[[bus]]
name = "left"
nodes = 8
[[bus]]
name = "right"
nodes = 8
"""
#: Measurements in a row with the same sums, ten a second: longer than the longest refresh.
AT_REST = 15
#: A slow guest lets the nodes wait for their processor.
ANSWER_S = 20.0
#: SDO requests for one object: the gateway's may cross ours.
TRIES = 10


class Skin:
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
        np.save(self._touch, np.round(3000 * np.exp(-((rows - 6) ** 2 + (columns - 14) ** 2) / 30))[None].astype("u2"))

    def start(self, name: str) -> None:
        touch = ("--input", str(self._touch), "--full-scale", "4095") if name == "nodes" else ()
        self._processes.skin(name, name, *self._arguments, *touch)

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

    def steps_n(self, sums_n: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Return the distance of neighbouring coarse values at sums."""
        law = self.contract.law
        return np.array([[coarse_step(value, k == 0, law) for k, value in enumerate(row)] for row in sums_n.tolist()])


@pytest.fixture(scope="module")
def skin(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Skin]:
    folder: Path = tmp_path_factory.mktemp("adaptive")
    path = folder / "rest.toml"
    path.write_text(LAYOUT)
    endpoint = free_endpoint()
    fabric = Fabric("rest", "test", endpoint, hub=True)
    try:
        with Processes(folder) as processes:
            arguments = ("-i", "socketcan", "-c", "vcan0", "--layout", str(path), "--connect", endpoint)
            started = Skin(load_layout(path, adaptive=True), processes, fabric, arguments)
            started.start("nodes")
            started.start("gateway")
            yield started
    finally:
        fabric.close()


def codes_of(skin: Skin) -> npt.NDArray[np.int64]:
    """Return the coarse codes that each node has for its sums now (2110h), as a CANopen client reads them.

    Of a node whose first sum is 0 nothing more is read: no force is below 0, so all its sums are.
    """
    codes = np.full((len(skin.contract.nodes), 4 * GROUP_SUMS), OTHER_CODES + 1)
    for bus in range(2):
        network = canopen.Network()
        network.connect(interface="socketcan", channel=f"vcan{bus}")
        try:
            for node in skin.contract.on_bus(bus):
                client = network.add_node(node.node_id, canopen.ObjectDictionary())
                client.sdo.RESPONSE_TIMEOUT = ANSWER_S
                codes[node.block, 0] = read(client, OD_COARSE, 1)
                if codes[node.block, 0]:
                    codes[node.block, 1:] = [read(client, OD_COARSE, place) for place in range(2, codes.shape[1] + 1)]
        finally:
            network.disconnect()
    return codes


def read(node: canopen.RemoteNode, index: int, subindex: int) -> int:
    for _ in range(TRIES):
        try:
            return int(struct.unpack("<B", node.sdo.upload(index, subindex))[0])
        except (canopen.SdoCommunicationError, canopen.SdoAbortedError, struct.error):
            continue
    pytest.fail(f"{index:04X}h sub {subindex} could not be read")


def test_what_the_gateway_holds_is_what_each_node_has_within_its_code(skin: Skin) -> None:
    held_n = skin.await_rest()
    law = skin.contract.law
    codes = codes_of(skin)
    own_n = np.array([[coarse_value(code, k == 0, law) for k, code in enumerate(row)] for row in codes.tolist()])
    assert (np.abs(held_n - own_n) <= skin.steps_n(own_n)).all()
    assert np.count_nonzero(codes[:, 0]) >= 4  # a touch that several boards feel
    assert skin.statuses[-1].frames.malformed == 0


def test_a_gateway_that_comes_back_knows_the_whole_skin_again(skin: Skin) -> None:
    before_n = skin.await_rest()
    skin.kill("gateway")
    skin.start("gateway")
    after_n = skin.await_rest()
    assert (np.abs(after_n - before_n) <= skin.steps_n(before_n)).all()


def test_nodes_that_go_are_dead_and_whole_when_they_are_back(skin: Skin) -> None:
    before_n = skin.await_rest()
    skin.kill("nodes")
    skin.await_states(BlockState.DEAD)
    newest = skin.measurements[-1]
    assert not any(newest.valid)
    assert not any(newest.known)
    skin.start("nodes")
    after_n = skin.await_rest()
    assert (np.abs(after_n - before_n) <= skin.steps_n(before_n)).all()
