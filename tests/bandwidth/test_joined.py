"""A gateway that joins, or has lost frames, is whole within a second, against boards on the arbitrated bus."""

import os

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.bandwidth.joined_bus import JoinedBus, shipped

#: Skins of the long test; docs/bandwidth.md names three hundred.
JOINS = int(os.environ.get("SKIN_JOINS", "6"))
BLOCKS = tuple(node.block for node in shipped().on_bus(0))


@pytest.mark.heavy
@given(
    moving=st.one_of(st.just(frozenset[int]()), st.frozensets(st.sampled_from(BLOCKS))),
    before_ms=st.integers(1, 300),
    stalled_ms=st.integers(0, 60),
    joins=st.booleans(),
    seed=st.integers(0, 2**16),
)
@settings(max_examples=JOINS, deadline=None)
def test_a_skin_is_whole_within_a_second(
    moving: frozenset[int], before_ms: int, stalled_ms: int, joins: bool, seed: int
) -> None:
    skin = JoinedBus(moving, seed)
    skin.until_whole_ms(2000)
    skin.run(before_ms)
    skin.stall(stalled_ms)
    if joins:
        skin.join()
    assert skin.until_whole_ms(2000) <= 1000
