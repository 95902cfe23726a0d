"""What the gateway answers to those who ask for its calibration, and what it writes to nodes."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

import gateway.calibration
from canskin.calibration_messages import CalibrationReply, CalibrationRequest, CalibrationState
from canskin.messages import Measurement
from dbc.contract import Contract
from gateway.calibration import GatewayCalibration
from skin.calibration_file import StoredCalibration, encoded, new_calibration, parse_calibration
from tests.calibration.skins import LAYOUT, Skin, offsets_n, pressed
from tests.gateway.boards import small_adaptive
from tests.gateway.world import World
from tests.layouts import ADAPTIVE_SKIN, small_contract
from tests.messages import adaptive_measurement


class Asked:
    """A calibration on a world, and the answers that came."""

    def __init__(self, world: World, stored: StoredCalibration | None = None, *, tares: bool = True) -> None:
        self.world = world
        self.calibration = GatewayCalibration(world.contract, stored, tares=tares)
        self.replies: list[CalibrationReply] = []

    def ask(self, request: CalibrationRequest) -> None:
        self.calibration.ask(request, self.replies.append)  # type: ignore[arg-type]

    def run(self, seconds: float, *, measured: bool = True) -> Measurement:
        last: Measurement | None = None
        for _ in range(round(seconds / self.world.step_s)):
            for each in self.world.step():
                last = self.calibration.apply(each)
                if measured:
                    self.calibration.take(each)
                    self.calibration.work()
            self.calibration.tick(self.world.gateway.masters, self.world.now_s)
        assert last is not None
        return last


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


def test_the_calibration_in_use_is_told(world: World, stored: StoredCalibration) -> None:
    asked = Asked(world, stored, tares=False)
    asked.ask(CalibrationRequest(action="show"))
    asked.run(0.1)
    told = parse_calibration(asked.replies[0].content, world.contract.layout, "test")
    assert told.offsets_n == pytest.approx(stored.offsets_n)
    assert told.gains == stored.gains


def test_a_touched_skin_gets_no_zero_by_tare() -> None:
    calibration = GatewayCalibration(Contract.from_layout(LAYOUT))
    replies: list[CalibrationReply] = []
    skin, force_n = Skin(calibration), offsets_n() + pressed(10, 20, 20, 0.005)
    calibration.ask(CalibrationRequest(action="tare"), replies.append)  # type: ignore[arg-type]
    calibration.tick({}, 0.0)
    skin.run(4.0, lambda _time_s: force_n)
    calibration.tick({}, 4.0)
    assert [each.is_done for each in replies] == [False]
    assert "something touches the skin" in replies[0].text


@pytest.mark.parametrize("speed_per_s", [0.0, 6.0])
def test_a_tare_under_a_touch_or_in_motion_leaves_the_offsets(speed_per_s: float) -> None:
    lines: list[CalibrationReply] = []
    calibration = GatewayCalibration(Contract.from_layout(LAYOUT))
    skin = Skin(calibration)
    before = skin.run(4.0, lambda _time_s: offsets_n())
    calibration.ask(CalibrationRequest(action="tare"), lines.append)  # type: ignore[arg-type]
    calibration.tick({}, 0.0)
    after = skin.run(4.0, lambda time_s: offsets_n() + pressed(4 + round(speed_per_s * (time_s - 4.0)), 20, 9, 0.005))
    calibration.tick({}, 4.0)
    ((is_done, text),) = [(each.is_done, each.text) for each in lines]
    assert not is_done
    assert text.startswith("something touches the skin or moves on it, around row ")
    assert text.endswith(": the zero stays as it was")
    assert calibration.status().state is CalibrationState.FOLLOWING
    counts = [np.frombuffer(each.offsets, "<i4") for each in (before, after)]
    change_n = np.diff(counts, axis=0) * LAYOUT.taxels.newton_per_count
    assert np.abs(change_n).max() < 2e-3  # a sum with a taxel under the touch changes by 5 mN


def test_a_forced_tare_is_answered_when_it_is_done(world: World) -> None:
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


def test_a_calibration_is_loaded_while_the_gateway_runs(world: World, stored: StoredCalibration) -> None:
    asked = Asked(world, tares=False)
    assert asked.run(0.2).offsets == b""
    asked.ask(CalibrationRequest(action="load", content=encoded(stored)))
    assert asked.run(0.2).offsets
    assert asked.replies[0].is_done


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
    content = encoded(msgspec.structs.replace(stored, **changed))
    asked.ask(CalibrationRequest(action=action, content=content))  # type: ignore[arg-type]
    asked.run(0.1)
    assert not asked.replies[0].is_done
    assert said in asked.replies[0].text


def test_nodes_that_make_sums_in_hardware_get_no_gains() -> None:
    world = World(small_contract(taxels={"frontend": "analogue"}))
    wanted = new_calibration(world.contract.layout, gains=np.full(world.contract.layout.taxels.count, 1.1))
    asked = Asked(world)
    asked.ask(CalibrationRequest(action="write", content=encoded(wanted)))
    asked.run(1.0)
    assert not asked.replies[0].is_done
    assert "take off no gains: 'skin reconstruct --gains' does" in asked.replies[0].text


def test_nodes_write_and_store_gains_and_offsets(small: Contract, tmp_path: Path) -> None:
    world = World(small, store=tmp_path)
    world.until_whole(2.0)
    taxels = small.layout.taxels
    gains = np.linspace(0.5, 2.0, taxels.count)
    offsets_n = np.linspace(0, 2e-3, taxels.count)
    wanted = msgspec.structs.replace(new_calibration(small.layout, gains=gains), taxel_offsets_n=offsets_n.tolist())
    asked = Asked(world)
    asked.ask(CalibrationRequest(action="write", content=encoded(wanted)))
    asked.run(10.0)
    assert [(each.is_done, each.text) for each in asked.replies] == [
        (True, "4 nodes have written and stored it; the zero is measured anew")
    ]
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
    asked.ask(CalibrationRequest(action="write", content=encoded(stored)))
    last = asked.run(5.0, measured=False)
    assert asked.replies[0].is_done
    assert not last.offsets
    assert asked.replies[0].text.endswith("see 'skin tare'") != tares


def test_gains_that_no_node_has_taken_are_not_told_as_those_in_use(small: Contract, stored: StoredCalibration) -> None:
    world = World(small)
    world.until_whole(2.0)
    asked = Asked(world)
    asked.ask(CalibrationRequest(action="write", content=encoded(stored)))
    asked.ask(CalibrationRequest(action="show"))
    asked.run(0.1)
    assert parse_calibration(asked.replies[0].content, small.layout, "test").gains == []


def test_loaded_offsets_are_those_until_a_zero_is_measured(world: World, stored: StoredCalibration) -> None:
    asked = Asked(world)
    asked.ask(CalibrationRequest(action="load", content=encoded(stored)))
    asked.run(0.1)
    assert asked.replies[0].text == "in use until the skin has been untouched for 3.2 s and has a new zero"


def test_requests_beyond_those_that_wait_are_refused(world: World) -> None:
    asked = Asked(world)
    for _ in range(9):
        asked.ask(CalibrationRequest(action="show"))
    assert "8 requests wait" in asked.replies[0].text
    asked.run(0.5)
    assert [each.is_done for each in asked.replies] == [False] + 8 * [True]


def test_a_slow_skin_says_how_long_its_zero_takes(small: Contract) -> None:
    layout = msgspec.structs.replace(small.layout, sync=msgspec.structs.replace(small.layout.sync, rate_hz=1.0))
    calibration = GatewayCalibration(Contract.from_layout(layout))
    replies: list[CalibrationReply] = []
    calibration.ask(CalibrationRequest(action="tare"), replies.append)  # type: ignore[arg-type]
    calibration.tick({}, 0.0)
    calibration.tick({}, 9.0)
    assert "which takes 64 s" in replies[0].text


@pytest.mark.heavy
def test_a_node_that_is_not_there_is_named(small: Contract, stored: StoredCalibration) -> None:
    world = World(small)
    world.until_whole(2.0)
    world.wires[1].loses = lambda end, each: end is world.wires[1].gateway and each["can_id"] & 0x7F == 2
    asked = Asked(world)
    world.run(2.0)
    asked.ask(CalibrationRequest(action="write", content=encoded(stored)))
    asked.run(40.0)
    assert [each.is_done for each in asked.replies] == [False]
    assert asked.replies[0].text.startswith("3 nodes have written and stored it; not bus1 node 2")


def test_adaptive_boards_look_after_their_zero() -> None:
    layout = small_adaptive().layout
    calibration = GatewayCalibration(small_adaptive())
    replies: list[CalibrationReply] = []
    content = encoded(new_calibration(layout, offsets_n=np.zeros(layout.measurement.sums)))
    calibration.ask(CalibrationRequest(action="load", content=content), replies.append)  # type: ignore[arg-type]
    calibration.tick({}, 0.0)
    assert not replies[0].is_done
    assert "power-up" in replies[0].text


@pytest.mark.parametrize("rate_hz", [1000, 2])
def test_adaptive_sums_are_looked_at_forty_times_a_second(rate_hz: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """However often they come: the newest hold, also when their newest frame is old."""
    calibration, looks = GatewayCalibration(Contract.from_layout(ADAPTIVE_SKIN)), list[int]()
    take = calibration._calibrator.take
    monkeypatch.setattr(calibration._calibrator, "take", lambda each: (looks.append(each.sampled_mono_ns), take(each)))
    force_n, replies = pressed(20, 20, 9, 0.005), list[CalibrationReply]()
    came = adaptive_measurement(force_n, layout=ADAPTIVE_SKIN, sampled_mono_ns=1)
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


class Written:
    """A writing to nodes that is done, and complete, at once."""

    done = is_complete = True

    def __init__(self, *_: object) -> None:
        """Write nothing."""

    def tick(self, _now_s: float) -> None:
        """Do nothing."""

    def text(self) -> str:
        return "4 nodes have written and stored it"


@pytest.mark.parametrize("is_adaptive", [False, True])
def test_the_revision_tells_of_every_load_and_write(
    small: Contract, monkeypatch: pytest.MonkeyPatch, *, is_adaptive: bool
) -> None:
    monkeypatch.setattr(gateway.calibration, "NodeWriting", Written)
    contract = small_adaptive() if is_adaptive else small
    calibration = GatewayCalibration(contract, tares=False)
    taxels, sums = contract.layout.taxels.count, contract.phi.shape[0]
    stored = new_calibration(contract.layout, offsets_n=np.zeros(sums), gains=np.full(taxels, 1.1))
    seen = [calibration.status().revision]
    for action in ("write", "write", *(() if is_adaptive else ("load", "load"))):
        request = CalibrationRequest(action=action, content=encoded(stored))  # type: ignore[arg-type]
        replies: list[CalibrationReply] = []
        calibration.ask(request, replies.append)  # type: ignore[arg-type]
        calibration.tick({}, 0.0)
        assert replies[0].is_done
        seen.append(calibration.status().revision)
    assert len(set(seen)) == len(seen)
    assert calibration.status().state is (CalibrationState.OFF if is_adaptive else CalibrationState.LOADED)


def test_the_revision_tells_of_every_zero(world: World) -> None:
    asked = Asked(world)
    asked.run(4.0)
    before = asked.calibration.status().revision
    asked.ask(CalibrationRequest(action="tare", force=True))
    asked.run(4.0)
    assert asked.replies[0].is_done
    assert asked.calibration.status().revision == before + 1
