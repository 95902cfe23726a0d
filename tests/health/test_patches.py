"""Total force and centre of pressure of regions, their thresholds, and forces in doubt."""

from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from health.patches import Patches
from health.state import ViewState
from skin.layout import Region
from tests.health.helpers import Messages, seen_of
from tests.layouts import tube_layout

REGIONS = [Region(name="top", box=(0, 0, 7, 15), threshold_n=0.1), Region(name="bottom", box=(8, 0, 15, 15))]


@pytest.fixture
def messages() -> Messages:
    made = Messages()
    made.layout = msgspec.structs.replace(made.layout, region=REGIONS)
    return made


@given(row=st.integers(0, 15), column=st.integers(0, 15), force_n=st.floats(1e-4, 0.02))
def test_a_single_force_is_in_its_region_at_its_place(row: int, column: int, force_n: float) -> None:
    messages = Messages()
    layout = msgspec.structs.replace(messages.layout, region=REGIONS)
    pixels = np.zeros((16, 16), np.float32)
    pixels[row, column] = force_n
    whole, *both = Patches(layout).of(messages.image(pixels=pixels), 0.0, 0.0)
    touched, free = both if row < 8 else reversed(both)
    position_m = layout.taxels.surface.positions_m[16 * row + column]
    for each in (whole, touched):
        assert each.force_n == pytest.approx(force_n)
        assert (each.row, each.column) == pytest.approx((row, column), abs=1e-4)
        assert each.position_m == pytest.approx(position_m, abs=1e-6)
    assert (free.force_n, free.row, free.column, free.position_m) == (0.0, None, None, None)


def test_a_region_over_its_threshold_in_any_image_is_named_for_a_second(messages: Messages) -> None:
    state = ViewState(messages.layout, 1000.0)
    top_n = float(messages.grid()[:8].sum())
    for at_s, force_n in ((1.0, 1e-4), (1.25, 0.02), (1.5, 0.01), (1.75, 1e-4)):  # nobody looks meanwhile
        state.take(messages.image(1, sync_s=at_s, pixels=messages.grid(force_n)), at_s)
    for now_s, is_over in ((1.75, True), (2.5, True), (2.5625, False)):
        snapshot = seen_of(state, now_s)
        top, bottom = snapshot.patches[1:]
        assert (top.is_over, top.over_since_time_s) == (is_over, 1001.25 if is_over else None)
        assert not bottom.is_over
        told = [
            (each.text, each.since_time_s)
            for each in snapshot.notices
            if (each.code, each.subject) == ("threshold", "top")
        ]
        text = f"up to {2 * top_n:.3g} N on top: more than its threshold of 0.1 N"
        assert told == ([(text, 1001.25)] if is_over else [])
    state.take(messages.image(1, sync_s=3.0), 3.0)
    assert seen_of(state, 3.0).patches[1].over_since_time_s == 1003.0


def test_what_was_not_measured_has_no_force_and_part_of_it_is_doubtful(messages: Messages) -> None:
    patches = Patches(messages.layout)
    assert not any(each.is_doubtful for each in patches.of(messages.image(), 0.0, 0.0))
    blocks = messages.layout.phi().block_of_taxel
    few = patches.of(messages.image(invalid=(int(blocks[0]),)), 0.0, 0.0)
    assert few[0].is_doubtful
    none = patches.of(messages.image(invalid=tuple(range(8))), 0.0, 0.0)
    assert [each.force_n for each in none] == [None, None, None]
    assert patches.total_n(messages.image(invalid=tuple(range(8)))) is None


def test_force_on_taxels_of_a_doubtful_zero_is_doubtful(messages: Messages) -> None:
    taxels = np.zeros(256, np.bool_)
    taxels[:128] = True
    image = msgspec.structs.replace(messages.image(), doubtful=np.packbits(taxels).tobytes())
    patches = Patches(messages.layout).of(image, 0.0, 0.0)
    assert [(each.name, each.is_doubtful) for each in patches] == [
        ("whole skin", True), ("top", True), ("bottom", False)
    ]  # fmt: skip


def test_the_centre_on_a_skin_of_positions_is_a_place_and_the_nearest_taxel() -> None:
    layout = tube_layout()
    pixels = np.zeros((1, layout.taxels.count), np.float32)
    pixels[0, 17] = 0.01
    image = Messages(layout).image(pixels=pixels)
    (whole,) = Patches(layout).of(image, 0.0, 0.0)
    assert (whole.row, whole.column) == (0.0, 17.0)
    assert whole.position_m == pytest.approx(layout.taxels.surface.positions_m[17], abs=1e-6)


def test_nothing_is_told_before_the_first_image(messages: Any) -> None:
    assert ViewState(messages.layout).snapshot(0.0)[0].patches == []
