"""Recognition and images: all nodes switch together, and no cycle is misread, whatever node missed the switch."""

import os
from functools import partial
from typing import Any

import msgspec
import numpy as np
import pytest

from canskin.calibration_messages import CalibrationState
from canskin.messages import MEASUREMENT, Measurement, Topic
from canskin.messages import RECOGNITION as RECOGNITION_TOPIC
from canskin.state_messages import ImagesReply, ImagesRequest
from dbc import indices as od
from dbc.board import board
from dbc.canopen import STATE_COB_ID, SYNC_COB_ID, NmtCommand
from dbc.database import database
from dbc.dictionary import SkinState
from gateway.calibration import GatewayCalibration
from gateway.service import GatewayService
from gateway.state_switch import REPEAT_S
from skin.calibration_file import new_calibration
from tests import messages as make
from tests.gateway.helpers import EndOfWire, World, two_states, valid

FAST_S = 0.01


CONTRACT = two_states()


class Skin(World):
    """A skin with two states; time goes on by a quarter of a period of recognition."""

    step_s = FAST_S / 4

    @property
    def states(self) -> list[int]:
        return [node.active_state for segment in self.segments for node in segment.boards.nodes]

    def is_image(self, measurement: Measurement) -> bool:
        return measurement.fingerprint == self.contract.phi.fingerprint

    def is_whole(self, measurement: Measurement) -> bool:
        phi = next(each.phi for each in self.contract.states if each.phi.fingerprint == measurement.fingerprint)
        return bool(valid(measurement)[phi.has_sums].all())

    def ask(self, hold_s: float) -> None:
        assert self.gateway.states is not None
        self.gateway.states.ask_images(hold_s)


@pytest.fixture
def skin() -> Skin:
    built = Skin(CONTRACT)
    while not any(built.is_whole(each) for each in built.step()):
        assert built.now_s < 103, built.lines
    return built


def test_recognition_sends_its_sums_at_its_rate(skin: Skin) -> None:
    skin.wires[0].log.clear()
    came = skin.run(1.0)
    assert 99 <= len(came) <= 101
    assert all(skin.is_whole(each) and not skin.is_image(each) and not skin.wrong_blocks(each) for each in came)
    sums = {can_id for can_id, _ in skin.wires[0].log if 0x180 < can_id < 0x580}
    assert sums == {tpdo.cob_id for node in CONTRACT.recognition.on_bus(0) for tpdo in node.tpdos}


@pytest.mark.parametrize("rest_s", [0.0, 3.0])
def test_images_come_whole_in_the_first_cycle_after_the_request_and_end(skin: Skin, rest_s: float) -> None:
    """Also after more SYNCs of recognition than a counter has values: a node that answered holds back no image.

    The fourth node has no sum in recognition, and proves itself in two cycles then.
    """
    skin.run(rest_s)
    skin.ask(0.4)
    came = skin.run(1.0)
    images = [each for each in came if skin.is_image(each)]
    late = 2 if rest_s else 0
    assert [skin.is_whole(each) for each in images] == [False] * late + [True] * (len(images) - late)
    assert all(valid(each)[:3].all() for each in images)
    assert 7 <= len(images) <= 9
    assert not any(skin.wrong_blocks(each) for each in came)
    after = [skin.is_whole(each) for each in came if each.cycle > images[-1].cycle]
    assert all(after)
    assert skin.gateway.states is not None
    assert skin.gateway.states.switches == 1
    assert 0.0 < skin.gateway.states.switch_s < 0.07 + late * 0.05
    status = skin.status()
    assert status.frames.missing == 0
    assert status.frames.late == late * len(skin.contract.nodes[3].tpdos)
    assert status.frames.accepted > 0


def test_request_that_is_renewed_goes_on(skin: Skin) -> None:
    skin.ask(0.3)
    skin.run(0.25)
    skin.ask(0.3)
    assert all(skin.is_image(each) for each in skin.run(0.25))
    assert not any(skin.is_image(each) for each in skin.run(0.6)[-20:])


@pytest.mark.parametrize("lost", [STATE_COB_ID, SYNC_COB_ID])
def test_nodes_that_miss_the_switch_are_not_valid_and_follow(skin: Skin, lost: int) -> None:
    wire = skin.wires[1]
    left = [4]

    def loses(end: EndOfWire, each: np.void) -> bool:
        is_lost = end is wire.nodes and each["can_id"] == lost and left[0] > 0
        left[0] -= is_lost
        return bool(is_lost)

    wire.loses = loses
    skin.ask(2.0)
    came = skin.run(2.0)
    assert left[0] == 0
    assert not any(skin.wrong_blocks(each) for each in came)
    assert skin.is_whole(came[-1])
    assert skin.states == [SkinState.IMAGES] * 4


def test_node_that_is_reset_while_images_come_follows(skin: Skin) -> None:
    skin.ask(10.0)
    skin.run(0.5)
    skin.nmt(0, NmtCommand.RESET_NODE, 1)
    skin.step()
    assert skin.states[0] == SkinState.RECOGNITION
    came = skin.run(2.0)
    assert not any(skin.wrong_blocks(each) for each in came)
    assert skin.is_whole(came[-1])


def test_switch_of_another_master_is_undone(skin: Skin) -> None:
    for wire in skin.wires:
        wire.put(STATE_COB_ID, bytes((SkinState.IMAGES,)))
    came = skin.run(REPEAT_S / 2) + skin.run(REPEAT_S)
    assert not any(skin.wrong_blocks(each) for each in came)
    assert not all(skin.is_whole(each) for each in came)
    assert all(skin.is_whole(each) for each in skin.run(0.2))


#: Requests for images of each of four seeds. Each is a switch to images and a switch back.
TURNS = int(os.environ.get("SKIN_SWITCHES", "240")) // 4


class Chance:
    """Loses RPDOs and SYNCs at the nodes, and holds frames of sums back until after the next SYNC, at random."""

    def __init__(self, skin: Skin, seed: int) -> None:
        self.draw = np.random.default_rng(seed)
        self.is_on = False
        self._skin = skin
        for wire in skin.wires:
            wire.loses = partial(self._loses, wire.nodes)
            wire.holds = self._holds

    def _loses(self, nodes: EndOfWire, end: EndOfWire, each: np.void) -> bool:
        part = {STATE_COB_ID: 0.4, SYNC_COB_ID: 0.2}.get(int(each["can_id"]), 0.0)
        return self.is_on and end is nodes and self.draw.random() < part

    def _holds(self, each: np.void) -> bool:
        return bool(self.is_on and 0x180 < each["can_id"] < 0x580 and self.draw.random() < 0.3)

    def step(self) -> list[Measurement]:
        """Go on; after a SYNC let the frames go that were held before."""
        held, syncs = [wire.waiting for wire in self._skin.wires], self._skin.gateway.sync.sent
        came = self._skin.step()
        if self._skin.gateway.sync.sent > syncs:
            for wire, count in zip(self._skin.wires, held, strict=True):
                wire.release(count)
            self._skin.carry()
        return came


@pytest.mark.heavy
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2, 3))])
def test_switches_at_random_moments_with_losses_late_frames_and_resets(seed: int) -> None:
    """What is valid is of its cycle and its state."""
    skin = Skin(CONTRACT)
    skin.run(1.0)
    chance = Chance(skin, seed)
    draw = chance.draw
    whole = images = count = wrong = 0
    states: list[int] = []
    assert skin.gateway.states is not None
    for turn in range(TURNS):
        chance.is_on = bool(turn % 2)
        skin.ask(float(draw.uniform(0.02, 0.14)))
        if chance.is_on and draw.random() < 0.1:
            skin.nmt(int(draw.integers(2)), NmtCommand.RESET_COMMUNICATION, int(draw.integers(1, 3)))
        for _ in range(int(draw.integers(70, 110))):
            came = chance.step()
            states.append(skin.gateway.states.state)
            wrong += sum(len(skin.wrong_blocks(each)) for each in came)
            whole += sum(skin.is_whole(each) for each in came)
            images += sum(skin.is_whole(each) and skin.is_image(each) for each in came)
            count += len(came)
    assert wrong == 0
    assert np.count_nonzero(np.diff(states)) > 1.8 * TURNS
    assert whole > count / 4
    assert images > TURNS / 10


class Told:
    """A fabric that keeps what is published, by topic."""

    def __init__(self) -> None:
        self.by_topic: dict[str, list[Any]] = {}

    def publish(self, topic: Topic, message: msgspec.Struct) -> None:
        self.by_topic.setdefault(topic.name, []).append(message)


def test_service_publishes_the_sums_of_recognition_in_every_cycle_and_answers_requests(skin: Skin) -> None:
    told, answers = Told(), list[ImagesReply]()
    service = GatewayService(CONTRACT, {}, told)
    service.loop = skin.gateway
    service.ask_images(ImagesRequest(hold_s=0.3), answers.append)
    service.ask_images(ImagesRequest(hold_s=0.0), answers.append)
    assert [each.is_done for each in answers] == [True, False]
    came = skin.run(1.0)
    service.publish(came)
    images = [each for each in came if skin.is_image(each)]
    assert told.by_topic[MEASUREMENT.name] == images
    few = told.by_topic[RECOGNITION_TOPIC.name]
    assert [each.cycle for each in few] == [each.cycle for each in came]
    assert {each.fingerprint for each in few} == {CONTRACT.recognition.phi.fingerprint}
    assert not any(skin.wrong_blocks(each) for each in few)
    assert sum(skin.is_whole(each) for each in few) == sum(skin.is_whole(each) for each in came)
    assert skin.status().state == "recognition"


def test_state_is_an_object_of_the_node(skin: Skin) -> None:
    """SDO writes what the RPDO writes; other values do not exist, and a node that is not operational takes no PDO."""
    node = skin.segments[0].boards.nodes[0]
    skin.write(0, 1, od.STATE, 1, bytes((SkinState.IMAGES + 1,)))
    skin.carry()
    assert node.local.get_data(od.STATE, 1)[0] == SkinState.RECOGNITION
    skin.write(0, 1, od.STATE, 1, bytes((SkinState.IMAGES,)))
    skin.carry()
    assert node.local.get_data(od.STATE, 1)[0] == SkinState.IMAGES
    node.boot(skin.now_s)
    skin.wires[0].put(STATE_COB_ID, bytes((SkinState.IMAGES,)))
    skin.carry()
    assert node.local.get_data(od.STATE, 1)[0] == SkinState.RECOGNITION
    assert skin.segments[0].boards.nodes[1].local.get_data(od.STATE, 1)[0] == SkinState.IMAGES


def test_database_and_contract_name_the_frames_of_both_states() -> None:
    text = database(CONTRACT, 0)
    assert f"BO_ {STATE_COB_ID} State: 1 Gateway" in text
    few = CONTRACT.recognition.nodes[1].tpdos[0]
    assert f"BO_ {few.cob_id} Node2_TPDO{few.number}_Recognition" in text
    assert few.cob_id not in {tpdo.cob_id for node in CONTRACT.on_bus(0) for tpdo in node.tpdos}
    table = board(CONTRACT, CONTRACT.nodes[1])
    assert [tpdo.state for tpdo in table.tpdos] == [SkinState.IMAGES, SkinState.IMAGES, SkinState.RECOGNITION]


def test_sums_of_recognition_have_the_offsets_of_theirs(skin: Skin) -> None:
    """The zero is that of all sums; a measurement of recognition teaches nothing about them."""
    offsets_n = np.linspace(-0.01, 0.01, CONTRACT.phi.shape[0])
    stored = new_calibration(CONTRACT.layout, offsets_n=offsets_n)
    calibration = GatewayCalibration(CONTRACT, stored, tares=False)
    few = skin.run(0.1)[-1]
    told = calibration.apply(few)
    counts = np.rint(offsets_n / CONTRACT.layout.taxels.newton_per_count)
    assert np.frombuffer(told.offsets, "<i4").tolist() == counts[CONTRACT.recognised].tolist()
    calibration.take(few)
    assert not calibration.needs_images(skin.now_s)
    assert GatewayCalibration(CONTRACT).needs_images(skin.now_s)


def test_a_zero_is_followed_while_nothing_asks_for_images() -> None:
    """Images come for a short time, again and again; a drift of every sum does not grow into forces."""
    calibration, phi = GatewayCalibration(CONTRACT), CONTRACT.phi
    drift_n_per_s = np.random.default_rng(0).normal(0, 5e-4, phi.shape[0])
    newton_per_count, period_s = CONTRACT.layout.taxels.newton_per_count, CONTRACT.layout.sync.period_s
    images, came, errors_n = 0, False, list[float]()
    for cycle in range(round(300 / period_s)):
        now_s = cycle * period_s
        sums = np.rint(drift_n_per_s * now_s / newton_per_count).astype("<i4")
        each = make.measurement(
            cycle,
            sampled_mono_ns=round((100 + now_s) * 1e9),
            sums=sums.tobytes(),
            valid=np.full(phi.blocks, came, np.uint8).tobytes(),  # not in the first cycle of images
            fingerprint=phi.fingerprint,
        )
        came = calibration.needs_images(100 + now_s)
        if came:
            images += 1
            calibration.take(each)
            calibration.work()
        elif now_s > 10:
            offsets = np.frombuffer(calibration.apply(each).offsets, "<i4")
            errors_n.append(float(np.abs(offsets - sums).max() * newton_per_count))
    assert calibration.status().state is CalibrationState.FOLLOWING
    assert images * period_s < 0.15 * 300
    assert max(errors_n) < 0.1 * 300 * float(np.abs(drift_n_per_s).max())


def test_a_sync_that_is_too_late_to_be_sent_does_not_switch(skin: Skin) -> None:
    """The state is that of the newest SYNC, and repeats of the RPDO are for SYNCs that are sent."""
    states, sync = skin.gateway.states, skin.gateway.sync
    assert states is not None
    states.ask_images(1.0)
    skin.gateway.tick(sync.due_s - FAST_S / 2)
    skin.carry()
    sent, late_s = sync.sent, 0.7 * CONTRACT.layout.sync.period_s
    skin.gateway.send_sync(sync.due_s + late_s)
    assert (sync.sent, states.state) == (sent, SkinState.RECOGNITION)
    skin.now_s = sync.due_s
    skin.gateway.send_sync(skin.now_s)
    assert (sync.sent, states.state) == (sent + 1, SkinState.IMAGES)
