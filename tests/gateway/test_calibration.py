"""What the gateway answers to those who ask for its calibration, and what it writes to nodes."""

import itertools
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np
import numpy.typing as npt
import pytest

from calibration.calibrator import Calibrator
from canskin.calibration_messages import (
    CalibrationReply,
    CalibrationRequest,
    CalibrationState,
    ZeroRequest,
    ZeroSupport,
)
from canskin.errors import InputError
from canskin.messages import Measurement
from canskin.sums import doubtful_taxels
from dbc import indices as od
from dbc.canopen import NmtCommand
from dbc.contract import Contract
from gateway.calibration import GatewayCalibration
from gateway.node_writing import node_values
from skin.calibration_file import StoredCalibration, encoded, new_calibration, parse_calibration
from skin.layout import changed
from tests.calibration.helpers import pressed
from tests.gateway.boards import small_stepped
from tests.layouts import STEPPED_SKIN, buses, small_contract
from tests.messages import stepped_measurement
from tests.world import World, valid


class Asked:
    """A calibration, with a world or without nodes, and the answers that came."""

    def __init__(self, skin: World | Contract, stored: StoredCalibration | None = None, **options: Any) -> None:
        self.world = skin if isinstance(skin, World) else None
        contract = skin if isinstance(skin, Contract) else skin.contract
        self.calibration, self.now_s = GatewayCalibration(contract, stored, **options), 0.0
        self.replies: list[CalibrationReply] = []
        self.told: list[Measurement] = []

    @property
    def answers(self) -> list[tuple[bool, str]]:
        return [(each.is_done, each.text) for each in self.replies]

    def ask(self, request: CalibrationRequest | ZeroRequest) -> None:
        self.calibration.ask(request, self.replies.append)  # type: ignore[arg-type]
        if self.world is None:
            self.tick()

    def give(self, action: Literal["load", "write"], stored: StoredCalibration) -> None:
        """Ask for a calibration to be used."""
        self.ask(CalibrationRequest(action=action, content=encoded(stored)))

    def tick(self, seconds: float = 0.0) -> None:
        """Let time pass without nodes."""
        self.now_s += seconds
        self.calibration.tick({}, self.now_s)

    def run(self, seconds: float, *, measured: bool = True) -> Measurement:
        last: Measurement | None = None
        assert self.world is not None
        for _ in range(round(seconds / self.world.step_s)):
            came = self.world.step()
            self.calibration.look(self.world.gateway.masters, self.world.now_s)
            for each in came:
                last = self.calibration.apply(each)
                self.told.append(last)
                if measured:
                    self.calibration.take(each)
                    self.calibration.work()
            self.calibration.tick(self.world.gateway.masters, self.world.now_s)
        assert last is not None
        return last


@pytest.fixture
def guarded(small: Contract) -> World:
    """Return a world whose calibration looks after changed gains."""
    built = World(small, calibrates=True)
    built.until_whole(2.0)
    return built


@pytest.fixture
def stored(small: Contract) -> StoredCalibration:
    offsets_n = np.linspace(-1e-3, 1e-3, small.phi.shape[0])
    gains = np.linspace(0.5, 2.0, small.layout.taxels.count)
    return new_calibration(small.layout, offsets_n=offsets_n, gains=gains)


def test_stored_offsets_are_in_every_measurement(world: World, stored: StoredCalibration) -> None:
    asked = Asked(world, stored, tares=False)
    last = asked.run(0.5)
    newton_per_count = world.contract.layout.taxels.newton_per_count
    np.testing.assert_allclose(
        np.frombuffer(last.offsets, "<i4") * newton_per_count, stored.sum_offsets_n(), atol=newton_per_count / 2
    )
    assert asked.calibration.status().state is CalibrationState.LOADED


@pytest.mark.parametrize("loses", [False, True])
def test_a_forced_tare_is_answered_when_it_is_done(world: World, *, loses: bool) -> None:
    """Every 37th frame of sums is lost, each of the four of a bus in its turn; that leaves no block without a zero."""
    for wire in world.wires if loses else []:
        sums, count = world.contract.table.cob_id.tolist(), itertools.count()
        wire.loses = lambda end, each, wire=wire, sums=sums, count=count: (
            end is wire.gateway and each["can_id"] in sums and next(count) % 37 == 0
        )
    asked = Asked(world)
    asked.ask(CalibrationRequest(action="tare", force=True))
    last = asked.run(8.0)
    assert [each.is_done for each in asked.replies] == [True]
    assert asked.replies[0].text.startswith("zero of 32 of 32 sums")
    assert last.offsets


def test_a_tare_without_valid_sums_says_so(world: World) -> None:
    asked = Asked(world)
    asked.ask(CalibrationRequest(action="tare"))
    asked.run(9.0, measured=False)
    assert [each.is_done for each in asked.replies] == [False]
    assert "fewer than half of the sums are valid" in asked.replies[0].text


@pytest.mark.parametrize(
    ("action", "changed", "said"),
    [
        ("load", {"fingerprint": "0" * 16}, "the calibration of another layout, 'small' with Φ 0000000000000000"),
        ("load", {"offsets_n": []}, "has no offsets of sums"),
        ("write", {"gains": []}, "has nothing for nodes"),
        ("write", {"gains": [1.0]}, "expected 128 gains, or none, got 1"),
        ("write", {"gains": [0.01] * 128, "taxel_offsets_n": [0.019] * 128}, "can hold -32768 to 32767"),
        ("load", {"skin": "x" * 100_000}, "expected 74752 at most for this skin"),
    ],
)
def test_what_cannot_be_used_is_refused(
    world: World, stored: StoredCalibration, action: str, changed: dict[str, object], said: str
) -> None:
    asked = Asked(world)
    asked.give(action, msgspec.structs.replace(stored, **changed))  # type: ignore[arg-type]
    asked.run(0.1)
    ((is_done, text),) = asked.answers
    assert not is_done
    assert said in text


def test_nodes_that_make_sums_in_hardware_get_no_gains() -> None:
    contract = small_contract(taxels={"frontend": "analogue"})
    asked = Asked(contract)
    asked.give("write", new_calibration(contract.layout, gains=np.full(128, 1.1)))
    ((is_done, text),) = asked.answers
    assert not is_done
    assert "take off no gains: 'skin reconstruct --gains' does" in text


@pytest.mark.parametrize("blocks_per_node", [1, 2])
def test_nodes_write_and_store_gains_and_offsets(blocks_per_node: int, tmp_path: Path) -> None:
    small = small_contract(bus=buses(*[2 // blocks_per_node] * 2, blocks_per_node=blocks_per_node))
    world = World(small, store=tmp_path)
    world.until_whole(2.0)
    taxels = small.layout.taxels
    gains = np.linspace(0.5, 2.0, taxels.count)
    offsets_n = np.linspace(0, 2e-3, taxels.count)
    wanted = msgspec.structs.replace(new_calibration(small.layout, gains=gains), taxel_offsets_n=offsets_n.tolist())
    asked = Asked(world)
    asked.give("write", wanted)
    asked.give("write", wanted)
    asked.run(10.0)
    asked.ask(ZeroRequest())
    asked.run(0.1)
    assert asked.answers == [
        (False, "the nodes are being written to: wait for the end of that"),
        (True, f"{len(small.nodes)} nodes have written and stored it; the zero is measured anew"),
        (True, "the calibration in use"),
    ]
    told = parse_calibration(asked.replies[-1].content, small.layout, "test")
    assert (told.gains, told.taxel_offsets_n) == (wanted.gains, wanted.taxel_offsets_n)
    np.testing.assert_allclose(world.electronics.gain, 1 / gains, rtol=1e-6)
    np.testing.assert_allclose(world.electronics.offset, -offsets_n / taxels.newton_per_count / gains, atol=0.5)
    assert len(list(tmp_path.iterdir())) == len(small.nodes)
    force_n = np.full(taxels.count, 5e-3)
    counts = (gains * force_n + offsets_n) / taxels.newton_per_count
    corrected = world.electronics.gain * counts + world.electronics.offset
    np.testing.assert_allclose(corrected * taxels.newton_per_count, force_n, atol=taxels.newton_per_count)


@pytest.mark.parametrize("tares", [True, False])
def test_offsets_of_sums_are_dropped_when_the_nodes_have_other_gains(
    small: Contract, stored: StoredCalibration, *, tares: bool
) -> None:
    world = World(small)
    world.until_whole(2.0)
    asked = Asked(world, stored, tares=tares)
    assert asked.run(0.1).offsets
    asked.give("write", stored)
    last = asked.run(5.0, measured=False)
    assert asked.replies[0].is_done
    assert not last.offsets
    assert asked.replies[0].text.endswith("see 'skin tare'") != tares


@pytest.mark.parametrize("tares", [True, False])
def test_the_zero_of_a_node_is_dropped_when_another_master_has_changed_its_gains(
    small: Contract, guarded: World, stored: StoredCalibration, *, tares: bool
) -> None:
    asked = Asked(guarded, stored, tares=tares)
    assert asked.run(0.5).offsets
    guarded.write(1, 2, od.GAIN, 3, bytes(4))
    last = asked.run(0.5)
    is_of_node = small.phi.block_of_sum == 3
    np.testing.assert_array_equal(np.frombuffer(last.usable, np.uint8), ~is_of_node)
    assert asked.calibration.status().recalibrated == ["bus1 node 2"]
    assert asked.calibration.status().zero_support[3] == ZeroSupport.NONE
    asked.ask(CalibrationRequest(action="tare", force=True))
    last = asked.run(6.0)
    assert not last.usable
    assert asked.calibration.status().recalibrated == []


def doubted(told: Measurement, contract: Contract) -> npt.NDArray[np.bool_]:
    """Return the blocks whose taxels are doubtful; all of a block's are, or none."""
    found = doubtful_taxels(told, contract.phi.shape[1])
    taxels = np.zeros(contract.phi.shape[1], np.bool_) if found is None else found
    blocks = np.isin(np.arange(contract.phi.blocks), contract.phi.blocks_of(taxels))
    np.testing.assert_array_equal(contract.phi.of_taxels(blocks), taxels)
    return blocks


def world_of(asked: Asked) -> World:
    assert asked.world is not None
    return asked.world


ACCEPTING: dict[str, Callable[[Asked, StoredCalibration], None]] = {
    "nobody": lambda _, __: None,
    "tare": lambda asked, _: asked.ask(CalibrationRequest(action="tare", force=True)),
    "tare of a region with all its taxels": lambda asked, _: asked.ask(
        CalibrationRequest(action="tare", region=(0, 0, 7, 15))
    ),
    "load": lambda asked, stored: asked.give("load", stored),
    "write": lambda asked, stored: asked.give("write", stored),
    "reset, which gives its stored gains back": lambda asked, _: world_of(asked).nmt(1, NmtCommand.RESET_NODE, 2),
    "written back": lambda asked, _: world_of(asked).write(1, 2, od.GAIN, 3, struct.pack("<f", 1.0)),
}


@pytest.mark.parametrize("how", ACCEPTING)
def test_a_block_is_doubtful_from_the_first_cycle_with_other_gains_until_somebody_accepts_them(
    small: Contract, guarded: World, stored: StoredCalibration, how: str
) -> None:
    asked = Asked(guarded, stored if "region" in how else None, tares=False)
    asked.run(0.5)
    assert not any(doubted(each, small).any() for each in asked.told)
    asked.told.clear()
    guarded.write(1, 2, od.GAIN, 3, bytes(4))
    asked.run(5.5)
    changed = [doubted(each, small) for each in asked.told if valid(each)[3]]
    assert len(changed) >= 100
    assert all(each.tolist() == [False, False, False, True] for each in changed)
    assert asked.calibration.status().recalibrated == ["bus1 node 2"]
    assert asked.calibration.status().doubtful_taxels == 32
    ACCEPTING[how](asked, stored)
    last = asked.run(6.0)
    assert valid(last)[3]
    assert doubted(last, small)[3] == (how == "nobody")
    assert asked.calibration.status().recalibrated == (["bus1 node 2"] if how == "nobody" else [])


def test_who_tares_a_part_of_a_board_does_not_accept_its_gains(
    small: Contract, guarded: World, stored: StoredCalibration
) -> None:
    asked = Asked(guarded, stored, tares=False)
    guarded.write(1, 2, od.GAIN, 3, bytes(4))
    asked.run(1.0)
    asked.ask(CalibrationRequest(action="tare", region=(0, 0, 7, 14)))
    last = asked.run(5.0)
    assert [each.is_done for each in asked.replies] == [True]
    assert doubted(last, small).tolist() == [False, False, False, True]


def test_a_gateway_that_starts_accepts_what_it_finds(guarded: World) -> None:
    guarded.write(1, 2, od.GAIN, 3, bytes(4))
    Asked(guarded, tares=False).run(1.0)
    guarded.gateway = guarded.new_gateway()
    asked = Asked(guarded, tares=False)
    last = asked.run(3.0)
    assert valid(last).all()
    assert not last.doubtful


def test_a_slow_skin_says_how_long_its_zero_takes(small: Contract) -> None:
    asked = Asked(Contract.from_layout(changed(small.layout, sync={"rate_hz": 1.0})))
    asked.ask(CalibrationRequest(action="tare"))
    asked.tick(9.0)
    assert "which takes 64 s" in asked.replies[0].text


@pytest.mark.heavy
def test_a_node_that_is_not_there_is_named(small: Contract, stored: StoredCalibration) -> None:
    world = World(small)
    world.until_whole(2.0)
    world.wires[1].loses = lambda end, each: end is world.wires[1].gateway and each["can_id"] & 0x7F == 2
    asked = Asked(world)
    world.run(2.0)
    asked.give("write", stored)
    asked.run(40.0)
    asked.ask(ZeroRequest())
    asked.run(0.1)
    assert [each.is_done for each in asked.replies] == [False, True]
    assert asked.replies[0].text.startswith("3 nodes have written and stored it; not bus1 node 2")
    assert parse_calibration(asked.replies[1].content, small.layout, "test").gains == []


def test_stepped_boards_look_after_their_zero() -> None:
    asked, layout = Asked(small_stepped()), small_stepped().layout
    asked.give("load", new_calibration(layout, offsets_n=np.zeros(layout.measurement.sums)))
    ((is_done, text),) = asked.answers
    assert not is_done
    assert "power-up" in text


@pytest.mark.parametrize("rate_hz", [1000, 2])
def test_stepped_sums_are_looked_at_forty_times_a_second(rate_hz: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """However often they come: the newest hold, also when their newest frame is old."""
    calibration, looks = GatewayCalibration(Contract.from_layout(STEPPED_SKIN)), list[int]()
    take = Calibrator.take

    def look(calibrator: Calibrator, each: Measurement) -> None:
        looks.append(each.sampled_mono_ns)
        take(calibrator, each)

    monkeypatch.setattr(Calibrator, "take", look)
    force_n, replies = pressed(20, 20, 9, 0.005), list[CalibrationReply]()
    came = stepped_measurement(force_n, layout=STEPPED_SKIN, sampled_mono_ns=1)
    for milliseconds in range(6000):
        if milliseconds % (1000 // rate_hz) == 0:
            last = calibration.apply(came)
            calibration.take(came)
        if milliseconds == 2000:
            asked = CalibrationRequest(action="tare", region=(18, 18, 30, 30))
            calibration.ask(asked, replies.append)  # type: ignore[arg-type]
        calibration.tick({}, 1.0 + 1e-3 * milliseconds)
        calibration.work()
    assert len(looks) == pytest.approx(240, abs=10)
    assert set(np.diff(looks) // 1_000_000) <= {25, 26}
    assert [each.is_done for each in replies] == [True]
    sums, offsets = (np.frombuffer(each, "<i4") for each in (last.sums, last.offsets))
    assert np.abs(sums - offsets).max() < 0.02 * np.abs(sums).max()


# Requests that meet others


def test_a_zero_that_is_awaited_counts_as_a_request_that_waits(small: Contract) -> None:
    asked = Asked(small, tares=False)
    for _ in range(8):
        asked.ask(CalibrationRequest(action="tare"))
    assert asked.replies == []
    asked.ask(ZeroRequest())
    assert [each.text for each in asked.replies] == ["8 requests wait for an answer: ask again later"]
    asked.tick(7.9)
    assert len(asked.replies) == 1
    asked.tick(0.2)
    assert [each.is_done for each in asked.replies] == [False] * 9


def test_show_tells_all_that_was_stored(small: Contract) -> None:
    known = msgspec.structs.replace(
        new_calibration(small.layout, offsets_n=np.full(32, 0.0078125), gains=np.full(128, 1.25)),
        taxel_offsets_n=[0.001] * 128,
    )
    asked = Asked(small, known, tares=False)
    asked.ask(ZeroRequest())
    told = parse_calibration(asked.replies[0].content, small.layout, "test")
    assert (told.gains, told.taxel_offsets_n, told.version) == ([1.25] * 128, [0.001] * 128, known.version)
    assert told.offsets_n == pytest.approx([0.0078125] * 32)
    assert asked.replies[0].status is not None


def test_a_tare_is_of_all_of_the_skin_or_of_a_region_on_it_and_one_at_a_time(small: Contract) -> None:
    asked, taxels = Asked(small, tares=False), small.layout.taxels
    whole = (0, 0, taxels.rows - 1, taxels.columns - 1)
    asked.ask(CalibrationRequest(action="tare", region=whole))
    asked.ask(CalibrationRequest(action="tare", region=whole))
    assert asked.replies == []
    asked.ask(CalibrationRequest(action="tare", force=True))
    assert asked.replies.pop().text == "another tare is under way: ask again when it has ended"
    asked.ask(CalibrationRequest(action="tare", region=(0, 0, taxels.rows, 0)))
    asked.ask(CalibrationRequest(action="tare", region=(0, 0, 1, 1), force=True))
    assert [each.is_done for each in asked.replies] == [False, False]
    assert asked.replies[0].text.startswith(f"region 0,0,{taxels.rows},0: expected first row, first column")
    assert asked.replies[1].text == "a tare of a region, and by force: expected one of both"
    asked.ask(CalibrationRequest(action="tare", region="thumb"))
    assert asked.replies[2].text == "no region 'thumb': expected 'whole skin'; [[region]] in the layout names more"


def test_answers_are_given_in_another_thread(small: Contract) -> None:
    aside: list[Callable[[], None]] = []
    asked = Asked(small, tares=False, submit=aside.append)
    asked.ask(ZeroRequest())
    asked.give("load", new_calibration(small.layout, offsets_n=np.zeros(32)))
    assert (len(aside), asked.replies) == (2, [])
    for each in aside:
        each()
    assert [each.text for each in asked.replies] == ["the calibration in use", "in use"]


# What nodes are given


def test_nodes_undo_gain_and_offset_of_a_taxel() -> None:
    """A taxel reads g f + o; the node takes x / g - o / g, in counts of 1 mN here."""
    skin = small_contract()
    known = msgspec.structs.replace(
        new_calibration(skin.layout, gains=np.full(128, 0.5)), taxel_offsets_n=[0.010] * 64 + [-0.020] * 64
    )
    for changes, factor, whole in (
        ({}, 2.0, [-20.0] * 64 + [40.0] * 64),
        ({"gains": []}, None, [-10.0] * 64 + [20.0] * 64),
        ({"taxel_offsets_n": []}, 2.0, None),
        ({"gains": [], "taxel_offsets_n": []}, None, None),
    ):
        gains, offsets = node_values(msgspec.structs.replace(known, **changes), 0.001)
        assert (None if gains is None else gains.tolist()) == (None if factor is None else [factor] * 128)
        assert (None if offsets is None else offsets.tolist()) == whole


def test_a_node_holds_offsets_of_sixteen_bits(small: Contract) -> None:
    known = new_calibration(small.layout)
    held = msgspec.structs.replace(known, taxel_offsets_n=[-32767.0, 32768.0] * 64)
    _, offsets = node_values(held, 1.0)
    assert offsets is not None
    assert offsets.tolist()[:2] == [32767.0, -32768.0]
    for beyond_n, counts in ((-32768.0, "32768"), (32769.0, "-32769")):
        values = [0.0] * 128
        values[5] = values[9] = beyond_n
        values[100] = 70_000.0
        with pytest.raises(InputError) as refused:
            node_values(msgspec.structs.replace(known, taxel_offsets_n=values), 1.0)
        assert str(refused.value) == (
            "taxel_offsets_n / gains of 3 taxels, first of taxel 5: nodes would add"
            f" {counts} counts, and can hold -32768 to 32767"
        )
