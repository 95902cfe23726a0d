"""Texts that choose nodes."""

import pytest

from canskin.errors import InputError
from dbc.choice import choose_nodes
from dbc.contract import Contract
from tests.layouts import buses, small_layout

CONTRACT = Contract.from_layout(small_layout(16, 16, bus=buses(3, 5, names=("left", "right"))))


@pytest.mark.parametrize(
    ("only", "without", "chosen"),
    [
        ([], [], {0: {1, 2, 3}, 1: {1, 2, 3, 4, 5}}),
        (["left:2"], [], {0: {2}}),
        (["right:2-4"], [], {1: {2, 3, 4}}),
        (["right:5", "left:1-1,right:1-2"], [], {0: {1}, 1: {1, 2, 5}}),
        ([], ["left:1-3"], {1: {1, 2, 3, 4, 5}}),
        ([], ["right:1-4", "left:3"], {0: {1, 2}, 1: {5}}),
        (["right:1-3"], ["right:2"], {1: {1, 3}}),
    ],
)
def test_nodes_are_chosen_by_bus_and_number(only: list[str], without: list[str], chosen: dict[int, set[int]]) -> None:
    assert choose_nodes(CONTRACT, only, without) == chosen


@pytest.mark.parametrize("text", ["middle:1", "left", "left:", "left:x", "left:1-", "left:1-2-3", ":1", "left:-1"])
def test_a_text_without_a_bus_and_a_number_is_refused(text: str) -> None:
    with pytest.raises(InputError) as caught:
        choose_nodes(CONTRACT, [text], [])
    assert str(caught.value) == f"expected BUS:NODE or BUS:FIRST-LAST with BUS of left, right, got '{text}'"


@pytest.mark.parametrize(
    ("text", "last"), [("left:0", 3), ("left:4", 3), ("left:2-4", 3), ("left:3-2", 3), ("right:0-5", 5), ("right:6", 5)]
)
def test_nodes_that_the_layout_does_not_have_are_refused(text: str, last: int) -> None:
    for only, without in (([text], []), ([], [text])):
        with pytest.raises(InputError, match=f"expected nodes of {text.partition(':')[0]}, 1-{last}, got"):
            choose_nodes(CONTRACT, only, without)


def test_a_choice_without_a_node_is_refused() -> None:
    with pytest.raises(InputError, match="no node is left to run: check --only and --without"):
        choose_nodes(CONTRACT, ["left:1"], ["left:1-3"])
