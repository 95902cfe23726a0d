from pathlib import Path

import numpy as np
import pytest

from canskin.errors import InputError
from skin.layout import load_layout, parse_layout
from skin.sources import (
    DEFAULT_OBJECTS,
    OBJECT_GROUPS,
    Frame,
    known_objects,
    load_objects,
    load_touches,
    object_names,
)


def test_a_group_is_named_among_objects() -> None:
    assert object_names(["ring,paper", "cup"]) == ("ring", *OBJECT_GROUPS["paper"])
    assert object_names([""]) == ()


def test_a_classifier_knows_the_default_objects_but_for_a_whole_group() -> None:
    assert known_objects([]) == DEFAULT_OBJECTS
    assert known_objects(["cup", "ring"]) == (*DEFAULT_OBJECTS, "cup")
    assert known_objects(object_names(["paper"])) == OBJECT_GROUPS["paper"]


def test_taxels_that_nothing_can_touch_feel_nothing() -> None:
    taxels = "rows = 32\ncolumns = 32"
    free, frame = (
        parse_layout(f"[taxels]\n{taxels}\n{more}".encode(), "palm")
        for more in ("", f"untouchable = {list(range(0, 1024, 2))}")
    )
    untouchable = np.arange(1024) % 2 == 0
    felt_n = 0.0
    for step in range(0, 200, 10):
        whole, part = (load_objects(each, names=("basketball",), seed=1).frame(step) for each in (free, frame))
        assert part.label == whole.label
        np.testing.assert_array_equal(part.force_n.ravel()[~untouchable], whole.force_n.ravel()[~untouchable])
        assert not part.force_n.ravel()[untouchable].any()
        felt_n += whole.force_n.ravel()[untouchable].sum()
    assert felt_n > 0
    assert load_objects(frame, seed=1).has_noise == load_objects(free, seed=1).has_noise
    learned, all_n = (load_touches(["basketball"], 20, each, seed=0).force_n for each in (frame, free))
    np.testing.assert_array_equal(learned.reshape(20, -1), np.where(untouchable, 0, all_n.reshape(20, -1)))


@pytest.mark.parametrize("given", [["cup,ring"], ["cup", "ring"], ["cup, ring,", "cup"]])
def test_names_with_spaces_or_commas_count_once(given: list[str]) -> None:
    assert object_names(given) == ("cup", "ring")
    assert object_names([]) == ()


def test_a_source_of_grids_alone_is_asked_for_nothing_else(monkeypatch: pytest.MonkeyPatch) -> None:
    class Flat:
        def __init__(self, rows: int, columns: int, pitch_m: float, rate_hz: float) -> None:
            self.has_noise, self.force_n = False, np.full((rows, columns), pitch_m, np.float32)

        def frame(self, step: int) -> Frame:
            return Frame(self.force_n, "")

    monkeypatch.setattr("skin.sources._load", lambda *_: Flat)
    assert load_objects(parse_layout(b"[taxels]\nrows = 8\ncolumns = 8", "mat")).frame(0).force_n.shape == (8, 8)
    with pytest.raises(InputError, match="Flat knows no taxels at positions: expected a parameter `surface`"):
        load_objects(load_layout(Path("forearm")))


def test_taxels_at_positions_are_touched() -> None:
    layout = load_layout(Path("forearm"))
    source = load_objects(layout, names=("golf-ball",), seed=1)
    held = [source.frame(step) for step in range(900, 3400 * 9, 3400)]
    assert {each.force_n.shape for each in held} == {(1, 230)}
    assert {each.label for each in held} == {"golf-ball"}
    assert len({int(each.force_n.argmax()) for each in held}) > 4
    learned = load_touches(["golf-ball"], 10, layout, seed=0, stroke="press")
    assert learned.force_n.shape == (10, 1, 230)
    assert learned.force_n.max(axis=(1, 2)).min() > 0.001
