"""The boards of a bus without a gateway: each cause that ``skin doctor`` finds there, and nothing on a healthy bus."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import msgspec
import numpy as np
import pytest

from bus.error_frames import bit_report
from bus.link import State
from commissioning.bus_look import BusLook
from dbc import indices as od
from dbc.canopen import HEARTBEAT_BASE, NMT_COB_ID, SDO_RESPONSE_BASE, NmtCommand
from dbc.contract import Contract
from health.snapshot import Notice
from nodes.hardware import Hardware
from nodes.sending import sending_of
from skin.defects import Defects
from skin.layout import Layout, load_layout
from tests.layouts import SHIPPED, buses, small_contract
from tests.world import EndOfWire, Shaking, Skin, little


class Bench(Skin):
    """The first bus of a skin, and who looks at it."""

    step_s = 0.005
    buses = 1
    state: ClassVar[State] = State.ACTIVE

    def new_hardware(self) -> Hardware:
        layout, blocks = self.contract.layout, [node.block for node in self.contract.nodes]
        options = {"noise_n": 0.0, "seed": 1, "defects": Defects.of({}, seed=1)}
        source = Shaking((layout.taxels.rows, layout.taxels.columns))
        return sending_of(layout).hardware(self.contract, blocks, source, None, **options)

    def look(self, each_step: Callable[[], object] = lambda: None) -> list[Notice]:
        link: Any = SimpleNamespace(send=self.wires[0].gateway.send, state=self.state)
        self.talk = BusLook(self.contract, 0, link, self.now_s)
        self.lead(self.talk, lambda _bus, arrived: self.talk.take(arrived, self.now_s), each_step)
        return self.talk.notices()

    def loses(self, *can_ids: int) -> "Bench":
        """Let nobody hear frames with these identifiers."""
        gateway: EndOfWire = self.wires[0].gateway
        self.wires[0].loses = lambda end, each: end is gateway and int(each["can_id"]) in can_ids
        return self


def told(found: list[Notice]) -> list[tuple[str, str]]:
    return [(each.level, each.code) for each in found]


def changed(contract: Contract, **parts: dict[str, Any]) -> Contract:
    layout: Layout = contract.layout
    more = {name: msgspec.structs.replace(getattr(layout, name), **keys) for name, keys in parts.items()}
    return Contract.from_layout(msgspec.structs.replace(layout, **more))


def test_nothing_is_wrong_with_boards_of_the_layout_and_none_is_commanded(small: Contract) -> None:
    bench = Bench(small)
    assert bench.look() == []
    assert not any(can_id == NMT_COB_ID for can_id, _ in bench.wires[0].log)


@pytest.mark.slow
@pytest.mark.parametrize("layout", SHIPPED)
def test_nothing_is_wrong_with_boards_of_each_layout(layout: str) -> None:
    assert Bench(Contract.from_layout(load_layout(Path(layout)))).look() == []


def test_boards_that_are_absent_stopped_or_do_not_answer(small: Contract) -> None:
    of_second = 2 + SDO_RESPONSE_BASE, 2 + HEARTBEAT_BASE
    (absent,) = Bench(small).loses(*of_second).look()
    assert (absent.level, absent.code, absent.text) == ("warning", "node-absent", "bus0: node 2 never heard")
    assert "skin scan" in absent.mend
    assert told(Bench(small).loses(of_second[0]).look()) == [("warning", "node-unanswered")]
    everybody = [base + node for base in (SDO_RESPONSE_BASE, HEARTBEAT_BASE) for node in (1, 2)]
    assert told(Bench(small).loses(*everybody).look()) == [("error", "node-absent")]
    behind = [base + node for base in (SDO_RESPONSE_BASE, HEARTBEAT_BASE) for node in (2, 3)]
    broken = Bench(small_contract(bus=buses(3, 1))).loses(*behind).look()
    assert told(broken) == [("error", "cable-break")]
    stopped = Bench(small)
    stopped.nmt(0, NmtCommand.STOP, 1)
    stopped.carry(lambda *_: None)
    assert told(stopped.look()) == [("warning", "node-unanswered")]


@pytest.mark.parametrize(
    ("parts", "code", "evidence"),
    [
        ({"device": {"product_code": 77}}, "node-other-device", "1018h:2"),
        ({"measurement": {"seed": 7}}, "node-refused", "2002h:0"),
    ],
)
def test_boards_of_another_kind_or_program(parts: dict[str, Any], code: str, evidence: str, small: Contract) -> None:
    (found,) = Bench(small, built=changed(small, **parts)).look()
    assert (found.level, found.code) == ("warning", code)
    assert evidence in found.text
    assert found.text.startswith("bus0: all nodes")


@pytest.mark.parametrize(
    ("configure", "level", "code"), [("write", "info", "node-starting"), ("refuse", "warning", "node-refused")]
)
def test_objects_that_the_gateway_writes_are_no_fault(configure: str, level: str, code: str) -> None:
    bench = Bench(small_contract(configure=configure))
    bench.write(0, 1, od.HEARTBEAT_MS, 0, little(500, 2))
    bench.carry(lambda *_: None)
    (found,) = bench.look()
    assert (found.level, found.code) == (level, code)
    assert "1017h:0" in found.text
    assert bench.segments[0].boards.nodes[0].local.get_data(od.HEARTBEAT_MS, 0) == little(500, 2)


def test_another_sync_and_unplanned_frames(small: Contract) -> None:
    bench = Bench(small)
    found = bench.look(lambda: bench.wires[0].put(0x80, b"\1"))
    assert told(found) == [("error", "other-sync")]
    assert "200 SYNCs a second" in found[0].text
    bench = Bench(small)
    found = bench.look(lambda: [bench.wires[0].put(0x300 + each, bytes(8)) for each in range(2)])
    assert told(found) == [("warning", "bus-load-above-plan")]


@pytest.mark.parametrize(
    ("state", "expected"),
    [
        (State.ACTIVE, ("warning", "bus-errors")),
        (State.PASSIVE, ("warning", "error-passive")),
        (State.BUS_OFF, ("error", "bus-off")),
        (State.LOST, ("error", "interface-lost")),
    ],
)
def test_errors_of_the_controller(
    state: State, expected: tuple[str, str], small: Contract, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Bench, "state", state)
    bench = Bench(small)
    found = bench.look(lambda: bench.talk.take(np.concatenate([bit_report(9, 0)] * 2), bench.now_s))
    assert expected in told(found)
    assert len(found) == 1
