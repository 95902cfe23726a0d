"""Gains and offsets are written to a few nodes at a time, three times at most."""

from types import SimpleNamespace
from typing import cast

import pytest

from dbc.contract import Contract
from gateway.nmt_master import NmtMaster
from gateway.node_writing import NodeWriting
from gateway.proof import Known
from gateway.sdo import SdoDialogue
from skin.layout import load_layout


class Master:
    """Takes questions, and answers as the test says."""

    def __init__(self, node_ids: list[int]) -> None:
        self.nodes = {each: SimpleNamespace(errand=None, known=Known(())) for each in node_ids}
        self.asked: list[int] = []
        self.is_free = True

    def ask(self, node_id: int, _steps: object, _now_s: float) -> SdoDialogue | None:
        if not self.is_free:
            return None
        self.asked.append(node_id)
        dialogue = SimpleNamespace(done=False, error=None)
        self.nodes[node_id].errand = dialogue
        return cast("SdoDialogue", dialogue)

    def end(self, node_id: int, error: str | None = None) -> None:
        errand = self.nodes[node_id].errand
        errand.done, errand.error = True, error


@pytest.fixture(scope="module")
def contract() -> Contract:
    return Contract.from_layout(load_layout())


@pytest.fixture
def master(contract: Contract) -> Master:
    return Master([node.node_id for node in contract.on_bus(0)])


@pytest.fixture
def writing(contract: Contract, master: Master) -> NodeWriting:
    return NodeWriting(contract, {0: cast("NmtMaster", master)}, None, None, 0.0)


def test_four_nodes_are_written_to_at_the_same_time(writing: NodeWriting, master: Master) -> None:
    writing.tick(0.0)
    writing.tick(0.1)
    assert master.asked == [1, 2, 3, 4]
    master.end(2)
    writing.tick(0.2)
    assert master.asked == [1, 2, 3, 4, 5]
    while not writing.done:
        for node_id in master.asked:
            master.end(node_id)
        writing.tick(0.3)
    assert master.asked == list(range(1, 33))
    assert writing.is_complete
    assert writing.text() == "32 nodes have written and stored it"


@pytest.mark.parametrize(("leaves", "why"), [(False, "no answer"), (True, "the node left the bus")])
def test_a_node_gets_three_attempts(writing: NodeWriting, master: Master, *, leaves: bool, why: str) -> None:
    for _ in range(100):
        writing.tick(0.0)
        for node_id in set(master.asked) - {3}:
            master.end(node_id)
        if leaves:
            master.nodes[3].errand = None
        else:
            master.end(3, "no answer")
    assert (writing.done, writing.is_complete) == (True, False)
    assert master.asked.count(3) == 3
    assert len(master.asked) == 34
    assert writing.text() == f"31 nodes have written and stored it; not bus0 node 3 ({why})"


def test_nodes_that_cannot_be_asked_for_twenty_seconds_are_given_up(writing: NodeWriting, master: Master) -> None:
    writing.tick(0.0)
    for node_id in (1, 2, 3, 4):
        master.end(node_id)
    master.is_free = False
    writing.tick(5.0)
    writing.tick(25.0)
    assert not writing.done
    writing.tick(25.1)
    assert writing.done
    assert writing.text() == "4 nodes have written and stored it; not bus0 nodes 5-32"


def test_what_failed_is_told_by_bus(contract: Contract) -> None:
    masters = {bus: Master([node.node_id for node in contract.on_bus(bus)]) for bus in (0, 1)}
    writing = NodeWriting(contract, cast("dict[int, NmtMaster]", masters), None, None, 0.0)
    masters[1].is_free = False
    for now_s in range(40):
        writing.tick(now_s)
        for node_id in masters[0].asked:
            masters[0].end(node_id, "abort" if node_id in {5, 3} else None)
    assert (writing.done, writing.is_complete) == (True, False)
    said = "30 nodes have written and stored it; not bus0 nodes 3, 5, bus1 nodes 1-32 (abort)"
    assert writing.text() == said
