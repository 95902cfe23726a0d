"""The zero of the default skin in scenes of `skin evaluate calibration`: what the documents promise."""

import pytest

from evaluation.schemes.zero_scenes import MISSED_PART, Press, Scene, judge_scene, scenes
from skin.layout import load_layout
from skin.zero_drift import ZeroDrift

NAMED = {scene.words: scene for scene in scenes(load_layout(), 0, 0)}
SHORT = (
    "whole skin drifts by -1 mN/s to -5 mN",
    "12 x 12 steps by -5 mN",
    "12 x 12 steps by +5 mN",
    "a board steps by +2 mN",
    "whole skin drifts by +1 mN/s to +5 mN, then all taxels but references are pressed",
    "boards with thermometers cool by 3 mN in a minute, then warm by +1 mN/s",
    "a hand of 2 mN a taxel during a step of the whole skin by -2 mN",
)


@pytest.mark.slow
@pytest.mark.parametrize("words", SHORT)
def test_ghosts_end_or_are_marked_and_touches_keep_their_force(words: str) -> None:
    row = judge_scene(NAMED[words], 0)
    assert row["its life s"] <= 10
    assert row["away mN"] < 0.5
    assert row["missed"] == 0
    assert (row["felt"] is None) == (not NAMED[words].presses)
    assert row["felt"] is None or row["felt"] >= 0.95


@pytest.mark.slow
def test_without_references_a_fast_rise_of_all_taxels_is_a_press_in_doubt() -> None:
    rise = ZeroDrift("whole", "step", 3e-3, 5)
    with_references, without = (judge_scene(Scene("", 20, (rise,), has_references=each), 0) for each in (True, False))
    assert with_references["right again s"] < 2
    assert without["right again s"] is None
    assert without["in doubt mN"] > 2


@pytest.mark.slow
def test_a_press_that_is_taken_for_zero_is_missed() -> None:
    """The judge's own: a zero that is forced under a press leaves nothing of it."""
    row = judge_scene(Scene("", 20, presses=(Press(5, 18, 3e-3),), tares=((6, None),)), 0)
    assert row["missed"] == 1
    assert row["felt"] < MISSED_PART
