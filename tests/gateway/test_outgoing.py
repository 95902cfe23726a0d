"""The master's frames: few at a time on the bus, in their order, and again at once where the queue was full."""

from hypothesis import given
from hypothesis import strategies as st

from dbc.canopen import SDO_REQUEST_BASE, SYNC_COB_ID
from dbc.frame import ECHO, ERROR, Frames
from gateway.batch import batch_of
from gateway.outgoing import LOST_S, UNDER_WAY, UNTOLD_S, Outgoing
from gateway.sdo import TIMEOUT_S
from tests.bus.harness import frame
from tests.layouts import small_contract

TABLE = small_contract().table


class Queue:
    """A transmit queue with some room."""

    def __init__(self, room: int) -> None:
        self.room = room
        self.waiting: list[Frames] = []
        self.sent: list[int] = []

    def send(self, burst: Frames) -> int:
        if len(self.waiting) >= self.room:
            return 0
        self.waiting.append(burst)
        return 1

    def transmit(self) -> Frames:
        """Return the echo of the frame that is transmitted."""
        echo = self.waiting.pop(0).copy()
        echo["flags"] |= ECHO
        self.sent.append(int(echo["data"][0, 0]))
        return echo


def echoes(arrived: Frames) -> int:
    return batch_of(arrived, 0, TABLE).echoes


def put(outgoing: Outgoing, numbers: range) -> None:
    for number in numbers:
        outgoing.put(SDO_REQUEST_BASE + 1 + number % 16, bytes((number,)))


@given(room=st.integers(1, 20), count=st.integers(1, 100), syncs=st.integers(0, 5))
def test_all_go_in_their_order_and_leave_room(room: int, count: int, syncs: int) -> None:
    queue = Queue(room)
    outgoing = Outgoing(queue.send, 0.0)
    put(outgoing, range(count))
    while queue.waiting:
        assert len(queue.waiting) <= UNDER_WAY
        for _ in range(syncs):
            outgoing.take(echoes(frame(SYNC_COB_ID, flags=ECHO)), has_gap=False)
            outgoing.take(echoes(frame(SDO_REQUEST_BASE + 1)), has_gap=False)
        outgoing.take(echoes(queue.transmit()), has_gap=False)
    assert queue.sent == list(range(count))


def test_refused_frame_goes_when_the_queue_has_room() -> None:
    queue = Queue(0)
    outgoing = Outgoing(queue.send, 10.0)
    put(outgoing, range(3))
    outgoing.tick(10.1)
    assert not queue.waiting
    queue.room = 2
    outgoing.tick(10.11)
    assert len(queue.waiting) == 2
    assert outgoing.flush()
    queue.room = 3
    assert not outgoing.flush()


def test_frame_that_has_waited_for_a_time_out_is_dropped() -> None:
    queue = Queue(0)
    outgoing = Outgoing(queue.send, 10.0)
    put(outgoing, range(3))
    outgoing.tick(10.0 + 1.1 * TIMEOUT_S)
    queue.room = 9
    assert not outgoing.flush()
    assert not queue.waiting


def test_lost_echoes_hold_up_nothing_for_long() -> None:
    queue = Queue(100)
    outgoing = Outgoing(queue.send, 0.0)
    put(outgoing, range(3 * UNDER_WAY))
    assert len(queue.waiting) == UNDER_WAY
    outgoing.take(0, has_gap=True)  # bus-off, an interface that went down, an overrun
    assert len(queue.waiting) == 2 * UNDER_WAY
    given_up = frame(SDO_REQUEST_BASE + 1, flags=ECHO | ERROR)
    outgoing.take(echoes(given_up), has_gap=False)
    assert len(queue.waiting) == 2 * UNDER_WAY + 1
    outgoing.tick(1.1 * LOST_S)
    put(outgoing, range(1))
    assert len(queue.waiting) == 2 * UNDER_WAY + 2


def test_where_echoes_tell_nothing_a_few_go_at_a_time() -> None:
    queue = Queue(100)
    outgoing = Outgoing(queue.send, 0.0, has_echoes=False)
    put(outgoing, range(10))
    for _ in range(10):
        outgoing.take(echoes(frame(SDO_REQUEST_BASE + 1, flags=ECHO)), has_gap=False)
    assert len(queue.waiting) == UNDER_WAY
    outgoing.tick(1.1 * UNTOLD_S)
    assert len(queue.waiting) == 2 * UNDER_WAY


def test_at_the_end_all_go_at_once() -> None:
    queue = Queue(30)
    outgoing = Outgoing(queue.send, 0.0)
    put(outgoing, range(32))
    assert outgoing.flush(most=1000)
    assert len(queue.waiting) == 30
    queue.transmit()
    queue.transmit()
    assert not outgoing.flush(most=1000)
