"""The newest messages wait, and no others."""

from health.arrivals import Newest
from tests.messages import label


def test_only_the_newest_message_of_a_topic_waits() -> None:
    newest = Newest()
    for number in range(5):
        newest.put("image", label(1, f"image {number}"))
        newest.put("label", label(1, f"label {number}"))
    assert newest.take(0.0) == [label(1, "image 4"), label(1, "label 4")]
    assert newest.skipped == 8
    assert newest.take(0.0) == []
