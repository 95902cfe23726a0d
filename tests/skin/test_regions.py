"""Regions: the whole skin, those of the layout, and the connected parts of a skin."""

from pathlib import Path

import numpy as np
import pytest

from canskin.errors import InputError, LayoutError
from skin.layout import layout_text, load_layout, parse_layout
from skin.regions import WHOLE, regions_of, taxels_of
from tests.layouts import layout_toml

GRID = layout_toml(16, 16)
TWO = """
[[region]]
name = "top"
box = [0, 0, 7, 15]
threshold_n = 0.5
[[region]]
name = "palm"
threshold_n = 2
"""


def test_a_skin_of_one_part_is_one_region() -> None:
    (whole,) = regions_of(parse_layout(GRID.encode(), "x.toml"))
    assert (whole.name, int(whole.taxels.sum()), whole.threshold_n) == (WHOLE, 256, None)


def test_the_connected_parts_of_a_skin_are_its_regions_without_gaps() -> None:
    hand = load_layout(Path("hand"))
    whole, *parts = regions_of(hand)
    assert [each.name for each in parts] == ["part0", "part1", "part2", "part3", "part4"]
    assert whole.taxels.sum() == hand.taxels.there
    np.testing.assert_array_equal(np.sum([each.taxels for each in parts], axis=0), whole.taxels)
    assert sorted(int(each.taxels.sum()) for each in parts) == [32, 32, 32, 32, 133]


def test_a_layout_names_its_regions_and_the_whole_skin_is_the_first() -> None:
    layout = parse_layout((GRID + TWO).encode(), "x.toml")
    assert [(each.name, int(each.taxels.sum()), each.threshold_n) for each in regions_of(layout)] == [
        ("palm", 256, 2.0),
        ("top", 128, 0.5),
    ]
    assert parse_layout(layout_text(layout).encode(), "again.toml") == layout


def test_a_part_has_the_name_of_the_layout() -> None:
    text = layout_text(load_layout(Path("hand"))) + '\n[[region]]\nname = "thumb"\npart = 2\n'
    hand = parse_layout(text.encode(), "hand.toml")
    _, thumb = regions_of(hand)
    np.testing.assert_array_equal(thumb.taxels, regions_of(load_layout(Path("hand")))[3].taxels)
    np.testing.assert_array_equal(taxels_of(hand, "thumb"), thumb.taxels)


def test_a_box_and_a_name_tell_taxels() -> None:
    layout = parse_layout((GRID + TWO).encode(), "x.toml")
    box = np.flatnonzero(taxels_of(layout, (1, 2, 2, 3)))
    assert box.tolist() == [18, 19, 34, 35]
    assert np.flatnonzero(taxels_of(layout, "top")).tolist() == list(range(128))
    with pytest.raises(InputError, match="no region 'thumb': expected 'palm', 'top'"):
        taxels_of(layout, "thumb")


@pytest.mark.parametrize(
    ("region", "says"),
    [
        ('name = "a"\nbox = [0, 0, 16, 3]', "region 'a': expected first row.* rows of 0 to 15"),
        ('name = "a"\nbox = [0, 0, 3]', r"got \[0, 0, 3\]"),
        ('name = "a"\nbox = [3, 0, 2, 1]', r"got \[3, 0, 2, 1\]"),
        ('name = "a"\npart = 1', "expected a part from 0 to 0, got 1"),
        ('name = "a"\npart = 0\nbox = [0, 0, 1, 1]', "expected `box` or `part`, got both"),
        ('name = "a"\n[[region]]\nname = "b"', "'a' and 'b' are both the whole skin"),
        ('name = "a"\n[[region]]\nname = "a"\npart = 0', "region name 'a' is used twice"),
        ('name = "a"\nthreshold_n = 0', r"\$.region\[0\].threshold_n"),
    ],
)
def test_a_region_that_is_none_is_named(region: str, says: str) -> None:
    with pytest.raises(LayoutError, match=says):
        parse_layout(f"{GRID}\n[[region]]\n{region}\n".encode(), "x.toml")


def test_a_region_of_gaps_alone_is_named() -> None:
    text = layout_text(load_layout(Path("hand")))
    hand = load_layout(Path("hand"))
    row, column = divmod(int(hand.taxels.gaps[0]), hand.taxels.columns)
    with pytest.raises(LayoutError, match="region 'hole': no taxel is in"):
        parse_layout(
            f'{text}\n[[region]]\nname = "hole"\nbox = [{row}, {column}, {row}, {column}]\n'.encode(), "x.toml"
        )
