"""Boot of the nodes of one bus: who is trusted and started, who is refused, and what is left behind."""

import threading
from collections.abc import Callable
from dataclasses import replace

import pytest

from bus.link import State
from dbc.contract import NMT_COB_ID, SDO_REQUEST_BASE, SDO_RESPONSE_BASE, Contract, NodeContract
from dbc.frame import Frames, frames
from gateway.boot import NMT_START, Boot
from gateway.network import MasterNetwork
from nodes.electronics import Electronics
from nodes.sampler import Sampler
from nodes.segment import Segment
from skin.layout import load_layout
from tests.nodes.conftest import ArrayLink, Still

PATIENCE_S = 30.0
NODES = (1, 2, 3)


class Wire:
    """A link whose far end answers at once, in the thread that sends; without nodes there is silence."""

    dropped = 0
    state = State.ACTIVE

    def __init__(self, nodes: Segment | None = None) -> None:
        self.sent: list[tuple[int, bytes]] = []
        self.heard: Callable[[int, bytearray, float], None] = lambda *_: None
        self.asked = threading.Event()
        self._nodes = nodes

    def send(self, burst: Frames) -> int:
        for frame in burst:
            self.sent.append((int(frame["can_id"]), frame["data"][: frame["length"]].tobytes()))
        self.asked.set()
        if self._nodes is not None and isinstance(self._nodes.link, ArrayLink):
            self._nodes.link.take_sent()
            self._nodes.link.waiting[:] = [burst]
            self._nodes.receive(0.0)
            for answer in self._nodes.link.take_sent():
                self.heard(int(answer["can_id"]), bytearray(answer["data"][: answer["length"]].tobytes()), 0.0)
        return len(burst)

    def receive(self) -> Frames:
        return frames(0)

    def fileno(self) -> int:
        raise NotImplementedError

    def close(self) -> None:
        pass


@pytest.fixture(scope="module")
def contract() -> Contract:
    return Contract.from_layout(load_layout())


def boot_of(wire: Wire, nodes: list[NodeContract], fingerprint: str, trusted: list[int]) -> tuple[Boot, MasterNetwork]:
    network = MasterNetwork(wire)
    wire.heard = network.notify
    return Boot("bus0", nodes, fingerprint, network, lambda node, _: trusted.append(node.node_id)), network


@pytest.fixture
def wire(contract: Contract) -> Wire:
    sampler = Sampler(contract.phi, Still(), Electronics(contract.layout.taxels, noise_n=0.0))
    segment = Segment(contract, 0, set(NODES), ArrayLink(), sampler)
    segment.boot(0.0)
    return Wire(segment)


def run(boot: Boot) -> None:
    """Let the first pass go by."""
    boot.start()
    assert boot._first_pass.wait(PATIENCE_S)
    boot.stop()
    boot._thread.join(PATIENCE_S)
    assert not boot._thread.is_alive()


def started(wire: Wire) -> list[int]:
    return [data[1] for can_id, data in wire.sent if can_id == NMT_COB_ID and data[0] == NMT_START]


def test_nodes_of_this_skin_are_trusted_and_started(contract: Contract, wire: Wire) -> None:
    trusted: list[int] = []
    boot, _ = boot_of(wire, [contract.on_bus(0)[place - 1] for place in NODES], contract.phi.fingerprint, trusted)
    run(boot)
    assert trusted == started(wire) == list(NODES)
    assert not boot.refused


def test_nodes_of_another_skin_are_refused_in_words(
    contract: Contract, wire: Wire, capsys: pytest.CaptureFixture[str]
) -> None:
    first, second, _ = contract.on_bus(0)[:3]
    trusted: list[int] = []
    boot, _ = boot_of(wire, [first, replace(second, block=7)], contract.phi.fingerprint, trusted)
    run(boot)
    assert (trusted, started(wire), boot.refused) == ([1], [1], {2})
    assert "node 2 on bus0 refused: expected block 7" in capsys.readouterr().err


def test_answers_that_nobody_asked_for_do_not_pile_up(contract: Contract, wire: Wire) -> None:
    boot, network = boot_of(wire, [contract.on_bus(0)[0]], contract.phi.fingerprint, [])
    run(boot)
    assert not list(network)
    assert not network.subscribers.get(SDO_RESPONSE_BASE + 1)


def test_stop_does_not_ask_the_nodes_that_still_wait(contract: Contract) -> None:
    silent = Wire()
    boot, _ = boot_of(silent, list(contract.on_bus(0)), contract.phi.fingerprint, [])
    boot.start()
    assert silent.asked.wait(PATIENCE_S)
    boot.stop()
    boot._thread.join(PATIENCE_S)
    assert not boot._thread.is_alive()
    assert len({can_id for can_id, _ in silent.sent}) < len(contract.on_bus(0))


class Endless(Wire):
    """A far end whose every object is a segmented transfer that never ends."""

    def send(self, burst: Frames) -> int:
        for frame in burst:
            command = int(frame["data"][0])
            if frame["can_id"] > SDO_REQUEST_BASE and command >> 5 == 2:  # initiate upload
                self.heard(SDO_RESPONSE_BASE + 1, bytearray([0x40, *frame["data"][1:4], 0, 0, 0, 0]), 0.0)
            elif frame["can_id"] > SDO_REQUEST_BASE and command >> 5 == 3:  # upload segment
                self.heard(SDO_RESPONSE_BASE + 1, bytearray([command & 0x10, *range(7)]), 0.0)
        return super().send(burst)


def test_a_transfer_without_end_is_left(contract: Contract, capsys: pytest.CaptureFixture[str]) -> None:
    wire, trusted = Endless(), []
    boot, _ = boot_of(wire, [contract.on_bus(0)[0]], contract.phi.fingerprint, trusted)
    run(boot)
    assert not trusted
    assert "answers strangely: object" in capsys.readouterr().err


class Disturbed(Wire):
    """A far end that aborts the first transfer as a lost toggle bit would, and then answers well."""

    def __init__(self, nodes: Segment | None) -> None:
        super().__init__(nodes)
        self._aborts = 1

    def send(self, burst: Frames) -> int:
        if self._aborts and burst["can_id"][0] > SDO_REQUEST_BASE:
            self._aborts -= 1
            code = (0x0503_0000).to_bytes(4, "little")
            self.heard(SDO_RESPONSE_BASE + 1, bytearray([0x80, 0, 0, 0, *code]), 0.0)
            return len(burst)
        return super().send(burst)


def test_a_disturbed_transfer_refuses_nobody(contract: Contract, wire: Wire) -> None:
    disturbed, trusted = Disturbed(wire._nodes), []
    boot, _ = boot_of(disturbed, [contract.on_bus(0)[0]], contract.phi.fingerprint, trusted)
    boot.start()
    assert boot._first_pass.wait(PATIENCE_S)
    assert (trusted, boot.refused) == ([], set())
    boot._check(contract.on_bus(0)[0])  # what asking again does
    assert trusted == [1]
    boot.stop()
