"""Heartbeat consumer of one node (CiA 301, 7.2.8.3.2)."""

from collections.abc import Collection

from dbc.canopen import HIGHEST_NODE_ID


class HeartbeatConsumer:
    """Watches other nodes; the watch on a node begins with its first heartbeat.

    Attributes
    ----------
    lost : set of int
        Node-IDs whose heartbeat is overdue.
    """

    def __init__(self) -> None:
        self._periods_s: dict[int, float] = {}
        self._due_s: dict[int, float] = {}
        self.lost: set[int] = set()

    def watch(self, entries: list[int]) -> None:
        """Set the nodes to watch from the entries of 1016h: node-ID in bits 16 to 23, time in ms in bits 0 to 15."""
        self._periods_s = {watched_node(entry): (entry & 0xFFFF) / 1000 for entry in entries if watched_node(entry)}
        self._due_s = {node: due_s for node, due_s in self._due_s.items() if node in self._periods_s}
        self.lost &= self._periods_s.keys()

    @property
    def watches(self) -> Collection[int]:
        """Node-IDs of the watched nodes."""
        return self._periods_s.keys()

    @property
    def due_s(self) -> float:
        """When the next heartbeat of a watched node becomes overdue."""
        if not self._due_s:
            return float("inf")
        return min((due_s for node_id, due_s in self._due_s.items() if node_id not in self.lost), default=float("inf"))

    def heard(self, node_id: int, now_s: float) -> None:
        """Note a heartbeat of `node_id`."""
        if node_id in self._periods_s:
            self._due_s[node_id] = now_s + self._periods_s[node_id]
            self.lost.discard(node_id)

    def check(self, now_s: float) -> None:
        """Add the nodes whose heartbeat is overdue to `lost`."""
        for node_id, due_s in self._due_s.items():
            if now_s > due_s:
                self.lost.add(node_id)


def watched_node(entry: int) -> int:
    """Return the node-ID that an entry of 1016h watches; 0 if the entry is unused."""
    node_id, time_ms = entry >> 16, entry & 0xFFFF
    return node_id if time_ms and node_id <= HIGHEST_NODE_ID else 0
