"""The newest messages wait, and no others."""

from canskin.messages import Label
from viewer.arrivals import Newest


def label(text: str) -> Label:
    return Label(cycle=1, sync_counter=1, sampled_mono_ns=0, label=text, confidence=1.0, valid_sums=1)


def test_only_the_newest_message_of_a_topic_waits() -> None:
    newest = Newest()
    for number in range(5):
        newest.put("image", label(f"image {number}"))
        newest.put("label", label(f"label {number}"))
    assert newest.take(0.0) == [label("image 4"), label("label 4")]
    assert newest.skipped == 8
    assert newest.take(0.0) == []
