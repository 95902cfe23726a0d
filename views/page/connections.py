"""The connections of the page's server: how many there may be, and how long a request may take to come."""

import asyncio
from collections.abc import Collection
from typing import Any, Final

from uvicorn.protocols.http.h11_impl import H11Protocol

#: Most connections, below the 1024 files that a process may have open by default.
CONNECTIONS_MAX: Final = 512
#: Most connections of one address.
CONNECTIONS_OF_ADDRESS_MAX: Final = 128
#: Most requests that are served at once without the page's token, WebSockets among them; the other places are for
#: whoever shows the token.
WITHOUT_TOKEN_MAX: Final = 64
#: A request has to be whole within this time, with its body.
REQUEST_S: Final = 5.0
HEADERS_BYTES_MAX: Final = 16384
#: Most connections that are accepted in one turn of the loop: a request that is there is read before it is the oldest.
BACKLOG: Final = 32


class Connection(H11Protocol):
    """A connection without a whole request is closed after `REQUEST_S`, and at once where others need its place."""

    _deadline: asyncio.TimerHandle | None = None
    since_s = 0.0

    def connection_made(self, transport: Any) -> None:
        """Take the connection, and keep to the limits."""
        super().connection_made(transport)
        self.since_s = self.loop.time()
        self._look()
        own = [each for each in self.connections if _address(each) == _address(self)]
        if len(own) > CONNECTIONS_OF_ADDRESS_MAX:
            self._close_one(own)
        elif len(self.connections) > CONNECTIONS_MAX:
            self._close_one(self.connections)

    def data_received(self, data: bytes) -> None:
        """Take a part of a request."""
        super().data_received(data)
        self._look()

    @property
    def is_waiting(self) -> bool:
        """Whether no request is whole and without its whole answer."""
        cycle: Any = self.cycle
        return cycle is None or cycle.more_body or cycle.response_complete

    def _look(self) -> None:
        """Start the clock of a request that is not whole, or stop the clock; a WebSocket has left `connections`."""
        is_due = self.is_waiting and self in self.connections
        if is_due and self._deadline is None:
            self._deadline = self.loop.call_later(REQUEST_S, self.transport.abort)
        elif not is_due and self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None

    def _close_one(self, rivals: Collection[Any]) -> None:
        """Close the connection that has waited longest; this one if all others are served."""
        waiting = (each for each in rivals if isinstance(each, Connection) and each.is_waiting and each is not self)
        oldest = min(waiting, key=lambda each: each.since_s, default=self)
        self.connections.discard(oldest)
        oldest.transport.abort()


def _address(connection: Any) -> str:
    return connection.client[0] if connection.client else ""
