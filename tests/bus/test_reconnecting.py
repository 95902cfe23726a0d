"""A link on one socket that comes back, here one end of a socket pair."""

import socket
from collections.abc import Iterator

import pytest

from bus.error_frames import State
from bus.reconnecting import ReconnectingLink


class PairLink(ReconnectingLink):
    def __init__(self) -> None:
        super().__init__()
        self.others: list[socket.socket] = []
        self.is_gone = False
        self.tries = 0
        self._use(self._connect())

    def _connect(self) -> socket.socket:
        self.tries += 1
        if self.is_gone:
            raise OSError("gone")
        mine, other = socket.socketpair()
        self.others.append(other)
        return mine


@pytest.fixture
def link() -> Iterator[PairLink]:
    link = PairLink()
    yield link
    link.close()
    for other in link.others:
        other.close()


def test_a_lost_socket_is_opened_again_but_not_at_once(link: PairLink, monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = 100.0
    monkeypatch.setattr("bus.reconnecting.time.monotonic", lambda: now_s)
    first = link._reopened()
    assert first is not None
    link._dropped = 3
    link._lose(first)
    link._lose(first)  # a second thread finds out, too
    assert (link.state, link.dropped) == (State.LOST, 3)
    assert link._reopened() is None
    link.is_gone = True
    waits = []
    for _ in range(5):
        since_s, tries = now_s, link.tries
        while link.tries == tries:
            now_s += 0.01
            assert link._reopened() is None
        waits.append(now_s - since_s)
    assert waits == pytest.approx([0.05, 0.1, 0.2, 0.2, 0.2], abs=0.02)
    link.is_gone = False
    now_s += 0.2
    assert link._reopened() is not None
    link._dropped = 2
    assert (link.state, link.dropped) == (State.ACTIVE, 5)
