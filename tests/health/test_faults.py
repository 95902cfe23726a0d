"""Each fault that a skin can have: its causes are named, no wrong block is valid, and the skin becomes whole again."""

import pytest

from docs.faults import PAGE, page
from health.causes import Cause
from tests.health.scenes import SCENES, Scene, played

pytestmark = pytest.mark.slow

#: Causes that no fault of a bus, board or service has, or that other tests cause.
ELSEWHERE = {
    "doctor": ("interface-differs", "bus-errors", "bus-load-above-plan", "host-setting"),
    "start": ("starting", "node-starting", "no-image", "node-away"),
    "calibration and forces": ("no-zero", "defect", "doubtful-force", "threshold", "node-frozen"),
    "others": ("recording-ended", "misfits"),
}


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
