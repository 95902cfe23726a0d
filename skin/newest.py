"""The newest message of each topic, for programs that must not fall behind."""

import threading

import msgspec


class Newest:
    """The newest message of each topic that nobody has taken; older messages are counted in `skipped`."""

    def __init__(self) -> None:
        self.skipped = 0
        self._waiting: dict[str, msgspec.Struct] = {}
        self._arrived = threading.Condition()

    def put(self, topic: str, message: msgspec.Struct) -> None:
        """Add a message in the place of an older one of its topic."""
        with self._arrived:
            self.skipped += topic in self._waiting
            self._waiting[topic] = message
            self._arrived.notify()

    def take(self, timeout_s: float) -> list[msgspec.Struct]:
        """Wait for messages, at most `timeout_s`, and return them in the order in which their topics came."""
        with self._arrived:
            self._arrived.wait_for(lambda: bool(self._waiting), timeout_s)
            taken, self._waiting = self._waiting, {}
        return list(taken.values())
