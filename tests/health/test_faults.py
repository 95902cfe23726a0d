"""Each fault that a skin can have: its causes are named, no wrong block is valid, and the skin becomes whole again."""

import os

import numpy as np
import pytest

from bus.link import State
from docs.faults import PAGE, page
from health.causes import Cause
from tests.health.scenes import BUSES, CALM_S, PATIENCE_S, SCENES, Scene, doubled, played
from tests.layouts import small_contract
from tests.watched import BusWire, Watched

pytestmark = pytest.mark.slow

#: Causes that no fault of a bus, board or service has, or that other tests cause.
ELSEWHERE = {
    "doctor": ("interface-differs", "bus-errors", "bus-load-above-plan", "host-setting"),
    "start": ("starting", "node-starting", "no-image", "service-absent", "node-away"),
    "calibration and forces": ("no-zero", "defect", "doubtful-force", "threshold", "node-frozen"),
    "others": ("recording-ended", "misfits"),
    "services of other machines": ("clock-unsure",),
}
#: Draws of overlapping faults, for example 1000.
DRAWS = int(os.environ.get("SKIN_FAULTS", "4"))
#: Faults that overlap: those of a bus at its usual rate.
OF_BUSES = [
    each
    for each in SCENES[: [scene.fault for scene in SCENES].index("the hub is away")]
    if not each.at_start and not each.tables
]


@pytest.mark.parametrize("scene", SCENES, ids=lambda scene: scene.fault)
def test_a_fault_is_named_and_the_skin_becomes_whole(scene: Scene) -> None:
    found = played(scene)
    assert tuple(found.named_s) == scene.codes
    assert found.wrong == []


def test_every_cause_has_a_scene() -> None:
    named = {code for scene in SCENES for code in scene.codes}
    elsewhere = {code for codes in ELSEWHERE.values() for code in codes}
    assert {cause.code for cause in Cause} == named | elsewhere


def test_the_page_is_that_of_the_scenes() -> None:
    assert PAGE.read_text("utf-8") == page(), "run python -m docs.faults"


@pytest.mark.parametrize("seed", range(DRAWS))
def test_overlapping_faults_leave_nothing_behind(seed: int) -> None:
    """Three faults begin one after another, and end in any order; of two that change the same thing the later wins."""
    random = np.random.default_rng(seed)
    world = Watched(small_contract(bus=BUSES))
    world.until_whole(3.0)
    ends = []
    drawn = random.choice(np.array(OF_BUSES, object), 3, replace=False)
    # Of a board that is out of order before the other board with its node-ID comes, nothing ever comes twice.
    for scene in sorted(drawn, key=lambda each: each.begin is not doubled):
        ends.append(scene.begin(world))
        world.run(random.uniform(0.1, 3.0))
    for place in random.permutation(3):
        ends[place]()
        world.run(random.uniform(0.0, 1.0))
    world.during = None
    for wire in world.wires:
        wire.loses = None
    ended_s = world.now_s
    world.until(lambda: world.now_s - max(ended_s, world.broken_s, world.said_s) > CALM_S, PATIENCE_S)
    assert not any(map(world.wrong_blocks, world.measured))
    assert world.link == [State.ACTIVE] * 2
    counts = world.status().frames
    assert world.heard_sums == counts.accepted + counts.late + counts.duplicate + counts.malformed
    for wire in world.wires:
        assert isinstance(wire, BusWire)
        sent = wire.bus.counts
        assert sent.accepted == sent.transmitted + sent.discarded
