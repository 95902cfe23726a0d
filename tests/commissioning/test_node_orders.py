"""``skin node reset``, ``stop`` and ``start``: the command reaches the nodes, and each is asked for its state."""

import pytest

from commissioning import node_orders_command
from commissioning.node_options import NodeOptions
from commissioning.node_orders import WAIT_S, NodeOrder
from dbc.canopen import NmtCommand, NmtState
from dbc.contract import Contract
from dbc.frame import ECHO, Frames, frames
from tests.bus.harness import frame
from tests.world import Skin


class Commanded(Skin):
    """Nodes 1 and 2, and who commands them."""

    step_s = 0.1
    buses = 1

    def order(self, command: NmtCommand, node_id: int, awaited: list[int]) -> NodeOrder:
        """Send a command, and pass on what the nodes say until the order is done."""
        order = NodeOrder(command, node_id, awaited, self.wires[0].gateway.send, self.now_s)
        self.lead(order, lambda _bus, arrived: order.take(arrived, self.now_s))
        return order


@pytest.mark.parametrize(
    ("command", "state"),
    [
        (NmtCommand.START, NmtState.OPERATIONAL),
        (NmtCommand.STOP, NmtState.STOPPED),
        (NmtCommand.RESET_NODE, NmtState.INITIALISING),
    ],
)
def test_a_command_is_for_one_node_or_for_all(small: Contract, command: NmtCommand, state: NmtState) -> None:
    one, both = Commanded(small).order(command, 2, [2]), Commanded(small).order(command, 0, [1, 2])
    assert (one.states, one.missing) == ({2: state}, [])
    assert (both.states, both.missing) == ({1: state, 2: state}, [])


def test_the_other_node_keeps_its_state(small: Contract) -> None:
    skin = Commanded(small)
    skin.order(NmtCommand.START, 0, [1, 2])
    skin.order(NmtCommand.STOP, 2, [2])
    assert [node.state for node in skin.segments[0].boards.nodes] == [NmtState.OPERATIONAL, NmtState.STOPPED]


def test_a_node_that_is_silent_or_keeps_another_state_is_missing_when_the_wait_is_over() -> None:
    order = NodeOrder(NmtCommand.STOP, 0, [1, 2, 3], len, 5.0)
    order.take(frame(0x701, b"\x05"), 5.1)
    order.take(frame(0x702, b"\x84"), 5.1)  # the toggle bit of node guarding
    for unused in (frame(0x703, b"\x04", flags=ECHO), frame(0x703, b"\x04\x04"), frame(0x704, b"\x04"), frames(0)):
        order.take(unused, 5.2)
    order.tick(5.0 + WAIT_S - 0.01)
    assert not order.done
    order.tick(order.due_s)
    assert order.done
    assert (order.states, order.missing) == ({1: 5, 2: 4, 3: None}, [1, 3])


def test_the_states_are_shown_and_a_silent_node_ends_with_1(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    sent: list[bytes] = []

    class Link:
        def send(self, burst: Frames) -> int:
            sent.extend(each["data"][: each["length"]].tobytes() for each in burst)
            return len(burst)

        def close(self) -> None: ...

    def run(order: NodeOrder, *_: object) -> None:
        order.take(frame(0x705, b"\x00"), 0.0)

    monkeypatch.setattr(node_orders_command, "open_links", lambda *_, **__: {0: Link()})
    monkeypatch.setattr(node_orders_command, "lead", run)
    assert node_orders_command.reset(of=NodeOptions(node=5, bus="bus0")) == 0
    assert node_orders_command.reset(of=NodeOptions(bus="bus0"), json=True) == 1
    assert sent == [b"\x81\x05", b"\x81\x00"]
    out = capsys.readouterr().out
    assert "initialising" in out
    assert '"5":"initialising"' in out
    assert '"32":null' in out
