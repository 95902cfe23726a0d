"""Contacts of simulated touches against the truth: what the documents promise of the default skin."""

import pytest

from evaluation.schemes.contacts import MEETING, measure_contacts


@pytest.mark.slow
@pytest.mark.parametrize(("name", "ticks"), [("golf-ball", 1400), (MEETING, 1200)])
def test_centre_force_and_identity_of_balls(name: str, ticks: int) -> None:
    row = measure_contacts(name, ticks, None, 3)
    balls = 1 if name == "golf-ball" else 2
    assert (row["regions"], row["identities"], row["ended"]) == (balls, balls, 0)
    assert row["right_number"] > 0.95
    assert row["centre_95"] < 0.5
    assert row["force_95"] < 0.05


@pytest.mark.heavy
def test_nothing_is_no_contact() -> None:
    row = measure_contacts("nothing", 300, None, 3)
    assert (row["identities"], row["right_number"]) == (0, 1)
    assert row["centre_median"] is None
