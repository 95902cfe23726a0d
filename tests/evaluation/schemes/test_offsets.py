"""Calibration of the default skin in the cases of `skin evaluate offsets`: what the documents promise."""

from dataclasses import replace

import pytest

from evaluation.schemes import offsets
from evaluation.schemes.offsets import CASES, measure_offsets


@pytest.mark.slow
@pytest.mark.parametrize("place", [2, 3])
def test_images_of_a_skin_with_offsets_are_within_1_db_of_those_without(place: int) -> None:
    row = measure_offsets(place, None, 3, labels=False)
    assert row["calibrated dB"] > row["no offsets dB"] - 1
    assert row["raw dB"] < row["no offsets dB"] - 10
    assert row["touched at the start"] == CASES[place].hand


@pytest.mark.slow
def test_after_drift_images_are_no_worse_than_2_db(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ten seconds of drift in place of the subject's minute."""
    drifting = replace(CASES[4], rest_s=10.0)
    monkeypatch.setattr(offsets, "CASES", (drifting,))
    row = measure_offsets(0, None, 3, labels=False)
    assert row["calibrated dB"] > row["no offsets dB"] - 2
