"""When a label counts."""

import pytest

from tests.messages import label


@pytest.mark.parametrize(
    ("valid_sums", "blind", "counts"), [(0, False, False), (255, False, False), (256, False, True), (1024, True, False)]
)
def test_label_counts_from_a_quarter_of_the_sums_on(valid_sums: int, blind: bool, counts: bool) -> None:
    assert label(valid_sums=valid_sums, blind=blind).is_measured(1024) is counts
