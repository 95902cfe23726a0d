"""The bound of a gateway that joins or has lost frames, against boards that run on the arbitrated bus."""

import os

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bandwidth.response import UNBOUNDED
from bandwidth.traffic import Disturbance
from bandwidth.urgency import Urgency
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
def test_a_skin_is_whole_within_the_bound(
    moving: frozenset[int], before_ms: int, stalled_ms: int, joins: bool, seed: int
) -> None:
    bound_ms = Urgency.of(shipped(), 0, Disturbance()).joined_ns[bool(moving)] / 1e6
    skin = JoinedBus(moving, seed)
    skin.until_whole_ms(2000)
    skin.run(before_ms)
    skin.stall(stalled_ms)
    if joins:
        skin.join()
    assert skin.until_whole_ms(2000) <= bound_ms
    assert bound_ms < 1000


def test_a_bus_that_is_too_slow_has_no_bound() -> None:
    urgency = Urgency.of(shipped(), 0, Disturbance(errors_per_s=5000))
    assert urgency.joined_ns == (UNBOUNDED, UNBOUNDED)
