"""The test vectors of a board name every frame that it can send."""

import json
from pathlib import Path

import numpy as np
import pytest

from dbc.board import board
from dbc.board_sums import PATTERN_FULL, PATTERN_OFF, PATTERN_RAMP, PATTERN_ZERO, node_payloads, pattern_counts
from dbc.contract import Contract
from dbc.vectors import vectors_text
from skin.layout import changed, load_layout


@pytest.mark.parametrize(("name", "turns"), [("fd", 1), ("forearm", 2)])
def test_frames_of_all_turns_are_listed_and_carry_the_sums_of_the_case(name: str, turns: int) -> None:
    """The first byte is the counter of the SYNC: that of the case, or in the second turn the next."""
    contract = Contract.from_layout(changed(load_layout(Path(name)), sync={"turns": turns}))
    node = contract.nodes[1]
    for case in json.loads(vectors_text(contract, node))["cases"]:
        frames = {each["cob_id"]: bytes.fromhex(each["data"]) for each in case["frames"]}
        assert {*frames} == {tpdo.cob_id for tpdo in board(contract, node).tpdos}
        for tpdo in node.tpdos:
            counter = case["sync_counter"] + tpdo.turn
            assert contract.turn_of(counter) == tpdo.turn
            sums = np.array(case["sums"], np.int32)
            assert frames[tpdo.cob_id] == node_payloads(contract, node, counter, sums)[tpdo.cob_id]
            assert frames[tpdo.cob_id][0] == counter


def test_a_pattern_takes_the_place_of_the_counts() -> None:
    """Four taxels of 0 to 2 counts."""
    assert pattern_counts(PATTERN_OFF, 4, 2) is None
    for pattern, counts in ((PATTERN_ZERO, [0, 0, 0, 0]), (PATTERN_RAMP, [0, 1, 2, 2]), (PATTERN_FULL, [2, 2, 2, 2])):
        np.testing.assert_array_equal(pattern_counts(pattern, 4, 2), counts)
