"""Heartbeats of other nodes."""

from nodes.heartbeat import HeartbeatConsumer


def test_consumer_waits_for_nobody_whose_loss_it_knows() -> None:
    """What is due says when to look next: a node that is gone must not keep it looking."""
    consumer = HeartbeatConsumer()
    consumer.watch([3 << 16 | 100, 4 << 16 | 500])
    assert consumer.due_s == float("inf")
    consumer.heard(3, 0.0)
    consumer.heard(4, 0.0)
    assert consumer.due_s == 0.1
    consumer.check(0.2)
    assert consumer.due_s == 0.5


def test_time_of_an_entry_is_in_milliseconds_and_the_loss_comes_after_it() -> None:
    consumer = HeartbeatConsumer()
    consumer.watch([1 << 16 | 1, 0x7F << 16 | 0xFFFF, 0x80 << 16 | 100, 5 << 16])
    assert set(consumer.watches) == {1, 0x7F}
    consumer.heard(1, 4.0)
    assert consumer.due_s == 4.001
    consumer.check(4.001)
    assert not consumer.lost
    consumer.check(4.001_001)
    assert consumer.lost == {1}
    consumer.heard(0x7F, 4.0)
    assert consumer.due_s == 4.0 + 65.535
