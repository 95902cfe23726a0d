"""Indices and data types of the object dictionary, as CiA 301 and docs/bus.md have them."""

import pytest

from dbc import indices as od


@pytest.mark.parametrize(
    ("first", "place", "index"),
    [(0x2003, 0, 0x2003), (0x2003, 1, 0x2203), (0x2100, 3, 0x2700), (0x2000, 7, 0x2E00), (0x21FF, 7, 0x2FFF)],
)
def test_objects_of_further_blocks_are_200h_apart(first: int, place: int, index: int) -> None:
    assert od.of_block(first, place) == index
    assert od.split_block(index) == (place, first)


@pytest.mark.parametrize("index", [0x1010, 0x1810, 0x1A10, 0x1900, 0x1FFF])
def test_objects_of_the_communication_profile_belong_to_no_block(index: int) -> None:
    """1A10h, a mapping, is not the gains of a block before the first."""
    assert od.split_block(index) == (0, index)
