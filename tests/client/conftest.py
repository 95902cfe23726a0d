"""What the tests of the client share. They use nothing of the application, and run on Python 3.10, too."""

import logging
import threading
from collections.abc import Iterator

import pytest

from canskin.errors import LOG
from tests.processes import PATIENCE_S


class Log(logging.Handler):
    """The client's warnings, as lines."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.lines: list[str] = []
        self._changed = threading.Condition()

    def emit(self, record: logging.LogRecord) -> None:
        with self._changed:
            self.lines.append(f"{record.__dict__['service']}: {record.getMessage()}")
            self._changed.notify_all()

    def wait_for(self, *expected: str) -> None:
        """Wait until every expected text begins a line."""
        with self._changed:
            all_there = self._changed.wait_for(
                lambda: all(any(line.startswith(text) for line in self.lines) for text in expected), PATIENCE_S
            )
            assert all_there, self.lines


@pytest.fixture
def log() -> Iterator[Log]:
    lines = Log()
    logging.getLogger(LOG).addHandler(lines)
    yield lines
    logging.getLogger(LOG).removeHandler(lines)
