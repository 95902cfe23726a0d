"""Adaptive nodes and their gateway on a real kernel: what the gateway holds is what the nodes would send."""

import struct
from collections.abc import Iterator

import canopen
import numpy as np
import numpy.typing as npt
import pytest

from canskin.messages import BlockState
from dbc import indices as od
from dbc.adaptive import GROUP_SUMS, OTHER_CODES, coarse_value
from tests.adaptive_skin import RestingSkin, resting_skin

#: A slow guest lets the nodes wait for their processor.
ANSWER_S = 20.0
#: SDO requests for one object: the gateway's may cross ours, on a busy guest many times in a row.
TRIES = 100


@pytest.fixture(scope="module")
def skin(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RestingSkin]:
    with resting_skin(tmp_path_factory.mktemp("adaptive"), "-i", "socketcan", "-c", "vcan0") as started:
        started.start("nodes")
        started.start("gateway")
        yield started


def codes_of(skin: RestingSkin) -> npt.NDArray[np.int64]:
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
                codes[node.block, 0] = read(client, od.COARSE, 1)
                if codes[node.block, 0]:
                    codes[node.block, 1:] = [read(client, od.COARSE, place) for place in range(2, codes.shape[1] + 1)]
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


def test_what_the_gateway_holds_is_what_each_node_has_within_its_code(skin: RestingSkin) -> None:
    held_n = skin.await_rest()
    law = skin.contract.law
    codes = codes_of(skin)
    own_n = np.array([[coarse_value(code, k == 0, law) for k, code in enumerate(row)] for row in codes.tolist()])
    assert (np.abs(held_n - own_n) <= skin.steps_n(own_n)).all()
    assert skin.is_true(held_n)
    assert np.count_nonzero(codes[:, 0]) >= 4  # a touch that several boards feel
    assert skin.statuses[-1].frames.malformed == 0


def test_a_gateway_that_comes_back_knows_the_whole_skin_again(skin: RestingSkin) -> None:
    before_n = skin.await_rest()
    skin.kill("gateway")
    skin.start("gateway")
    after_n = skin.await_rest()
    assert (np.abs(after_n - before_n) <= skin.steps_n(before_n)).all()


def test_nodes_that_go_are_dead_and_whole_when_they_are_back(skin: RestingSkin) -> None:
    before_n = skin.await_rest()
    skin.kill("nodes")
    skin.await_states(BlockState.DEAD)
    newest = skin.measurements[-1]
    assert not any(newest.valid)
    assert not any(newest.known)
    skin.start("nodes")
    after_n = skin.await_rest()
    assert (np.abs(after_n - before_n) <= skin.steps_n(before_n)).all()


def test_boards_in_c_show_the_touch(skin: RestingSkin) -> None:
    skin.kill("nodes")
    skin.await_states(BlockState.DEAD)
    skin.start("nodes", "--firmware")
    assert skin.is_true(skin.await_rest())
    assert skin.statuses[-1].frames.malformed == 0
