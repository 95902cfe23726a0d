"""When a label counts."""

import pytest

from canskin.messages import Label


@pytest.mark.parametrize(
    ("valid_sums", "blind", "counts"), [(0, False, False), (255, False, False), (256, False, True), (1024, True, False)]
)
def test_label_counts_from_a_quarter_of_the_sums_on(valid_sums: int, blind: bool, counts: bool) -> None:
    label = Label(
        cycle=1, sync_counter=1, sampled_mono_ns=0, label="", confidence=1.0, valid_sums=valid_sums, blind=blind
    )
    assert label.is_measured(1024) is counts
