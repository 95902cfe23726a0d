"""Least and longest of times that were measured lately."""

from hypothesis import given
from hypothesis import strategies as st

from gateway.spread import SPAN_S, Spread


@given(st.lists(st.tuples(st.floats(0, 5), st.floats(0.001, 9)), min_size=1, max_size=40))
def test_the_values_of_the_last_span_are_there_and_older_than_two_are_not(steps: list[tuple[float, float]]) -> None:
    spread, now_s, values = Spread(), 100.0, []
    for pause_s, value in steps:
        now_s += pause_s
        spread.add(value, now_s)
        values.append((now_s, value))
        least, longest = spread.of(now_s)
        fresh = [each for at_s, each in values if now_s - at_s < SPAN_S]
        kept = [each for at_s, each in values if now_s - at_s < 2 * SPAN_S]
        assert min(kept) <= least <= min(fresh)
        assert max(fresh) <= longest <= max(kept)
    assert spread.of(now_s + 2 * SPAN_S) == (0.0, 0.0)
