"""Questions by SDO to devices that other masters ask, too: asked while nobody else uses the device's SDO channel."""

from collections.abc import Callable, Iterable
from typing import Final

from dbc.canopen import SDO_REQUEST_BASE, SDO_RESPONSE_BASE
from gateway.foreign_sdo import SDO_QUIET_S
from gateway.sdo import Dialogue, SdoDialogue

#: A device that another master has kept busy for this long is asked no more.
BUSY_S: Final = 5.0


class Questions:
    """One dialogue with each of some devices: frames and times in, requests out.

    A dialogue begins when no frame of another client has come for `SDO_QUIET_S`. When another client asks meanwhile,
    the dialogue is dropped without an abort, which would end the transfer of that client. The dialogue begins
    again later.

    Parameters
    ----------
    steps : callable
        Returns the dialogue with a node-ID.
    send : callable
        Sends a classic frame: COB-ID and data.

    Attributes
    ----------
    left : list of int
        Node-IDs that are still to be asked.
    busy : set of int
        Node-IDs that other masters kept busy for `BUSY_S`.
    """

    def __init__(self, steps: Callable[[int], Dialogue], send: Callable[[int, bytes], None]) -> None:
        self._steps, self._send = steps, send
        self._free_s: dict[int, float] = {}
        self._waits_since_s: dict[int, float] = {}
        self._open: dict[int, SdoDialogue] = {}
        self.left: list[int] = []
        self.busy: set[int] = set()

    @property
    def done(self) -> bool:
        """Whether nothing is left, and no dialogue is open."""
        return not self.left and not self._open

    @property
    def under_way(self) -> int:
        """Number of open dialogues."""
        return len(self._open)

    def ask(self, node_ids: Iterable[int]) -> None:
        """Ask these devices, in this order, in place of those that are left."""
        self.left = list(node_ids)
        self.busy.clear()
        self._waits_since_s.clear()

    def take(self, base: int, node_id: int, data: bytes, now_s: float) -> None:
        """Use a frame that a device or another client sent: its identifier is `base` + `node_id`."""
        if base == SDO_RESPONSE_BASE and node_id in self._open:
            self._open[node_id].take(data, now_s)
        elif base in {SDO_REQUEST_BASE, SDO_RESPONSE_BASE}:
            self._free_s[node_id] = now_s + SDO_QUIET_S
            if node_id in self._open:
                del self._open[node_id]
                self.left.append(node_id)

    def tick(self, now_s: float) -> dict[int, SdoDialogue]:
        """Check times; return the dialogues that have ended, by node-ID."""
        for dialogue in self._open.values():
            dialogue.tick(now_s)
        ended = {node_id: each for node_id, each in self._open.items() if each.done}
        self._open = {node_id: each for node_id, each in self._open.items() if not each.done}
        return ended

    def begin(self, now_s: float) -> None:
        """Begin the next dialogue if a device is free, and give up devices that were busy for too long."""
        free = [each for each in self.left if now_s >= self._free_s.get(each, now_s)]
        for each in set(self.left) - set(free):
            if now_s - self._waits_since_s.setdefault(each, now_s) >= BUSY_S:
                self.left.remove(each)
                self.busy.add(each)
        if free:
            self.left.remove(free[0])
            self._open[free[0]] = SdoDialogue(free[0], self._steps(free[0]), self._send, now_s, attempts=1)
