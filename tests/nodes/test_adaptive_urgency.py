"""The urgency of news is that of the exact logarithm, by arithmetic that every machine rounds alike."""

import numpy as np
import pytest

from dbc.adaptive import LEVELS, SendingRule
from nodes.adaptive.sending import log2_of, urgency

RULE = SendingRule()
#: Ratios of difference over threshold, from just above 1 on.
RATIOS = np.exp2(np.random.default_rng(0).uniform(0, 40, 100_000))


def test_the_logarithm_is_right_to_the_last_bits_and_whole_for_powers_of_two() -> None:
    found = np.array([log2_of(ratio) for ratio in RATIOS])
    np.testing.assert_allclose(found, np.log2(RATIOS), rtol=4e-16, atol=1e-15)
    assert [log2_of(2.0**power) for power in range(-1074, 1024)] == list(range(-1074, 1024))


@pytest.mark.heavy
@pytest.mark.parametrize("waited", [0, 1, 2, 8, 23])
def test_levels_are_those_of_a_librarys_logarithm(waited: int) -> None:
    exact = (np.log2(RATIOS) + waited / RULE.doubling) / RULE.level_ratio
    expected = np.minimum(np.floor(exact), LEVELS - 2).astype(int)
    assert [urgency(ratio, waited, RULE) for ratio in RATIOS] == expected.tolist()


def test_news_that_has_waited_has_the_highest_level_alone() -> None:
    assert urgency(1e30, RULE.patience - 1, RULE) == LEVELS - 2
    assert urgency(1.0001, RULE.patience, RULE) == LEVELS - 1


def test_a_tiny_number_of_the_rule_makes_no_higher_level() -> None:
    assert urgency(3.0, 1, RULE._replace(doubling=1e-40, level_ratio=1e-40)) == LEVELS - 2
