"""The decision that is timed is the one that is right."""

import pytest

from evaluation.bench import classify


@pytest.mark.heavy
def test_compiled_decision_is_the_graphs() -> None:
    row = classify.measure_size(64, rounds=1)
    assert row["same_labels"]
    assert row["accuracy"] > 0.97
