"""Log lines that are equal for several nodes: written once, with all node-IDs."""

from collections.abc import Callable
from typing import Final

from skin.ranges import ranges_text

#: Equal lines within this time become one line.
GATHER_S: Final = 0.2


class GroupedLines:
    """Lines about the nodes of one bus.

    Parameters
    ----------
    bus : str
        Name of the bus.
    say : callable
        Takes a line for the log.
    """

    def __init__(self, bus: str, say: Callable[[str], None]) -> None:
        self._bus = bus
        self._say = say
        self._nodes_of: dict[str, list[int]] = {}
        self._since_s = float("inf")

    def add(self, node_id: int, text: str, now_s: float) -> None:
        """Keep a line until `GATHER_S` after the oldest kept line."""
        self._nodes_of.setdefault(text, []).append(node_id)
        self._since_s = min(self._since_s, now_s)

    def tick(self, now_s: float) -> None:
        """Log the kept lines when `GATHER_S` have passed."""
        if now_s - self._since_s >= GATHER_S:
            self.flush()

    def flush(self) -> None:
        """Log all kept lines now."""
        for text, node_ids in self._nodes_of.items():
            self._say(f"node{'s' * (len(node_ids) > 1)} {ranges_text(node_ids)} on {self._bus} {text}")
        self._nodes_of.clear()
        self._since_s = float("inf")
