"""Devices on the bus that are no boards of the skin: which of them say that they produce SYNC."""

from collections.abc import Callable
from typing import Final

from dbc import indices as od
from dbc.canopen import BASE_ID_MASK, SYNC_COB_ID
from gateway.questions import Questions
from gateway.sdo import Dialogue, Read
from skin.ranges import ranges_text

#: Bit 30 of 1005h: the node produces SYNC (CiA 301, 7.5.2.5).
PRODUCES_SYNC: Final = 1 << 30
#: The devices are asked again after this time at the earliest.
AGAIN_S: Final = 10.0


def produces_sync(cob_id: int) -> bool:
    """Tell of a value of 1005h whether its node produces SYNC with the identifier that a skin uses."""
    return bool(cob_id & PRODUCES_SYNC) and cob_id & BASE_ID_MASK == SYNC_COB_ID


class Strangers:
    """The nodes of a bus with other node-IDs than the skin's, known by their heartbeats.

    Parameters
    ----------
    send : callable
        Sends a classic frame: COB-ID and data.
    """

    def __init__(self, send: Callable[[int, bytes], None]) -> None:
        self._questions = Questions(_ask, send)
        self._known: set[int] = set()
        self._again_s = float("-inf")
        self._producers: set[int] = set()
        self._told = ""

    @property
    def words(self) -> str:
        """Who produces SYNC, and what to do."""
        if not self._producers:
            return "a bus of a skin has one SYNC producer: 'skin scan' tells which device has bit 30 of 1005h set"
        who = f"node{'s' * (len(self._producers) > 1)} {ranges_text(self._producers)}"
        return f"{who} produces SYNC, which is the gateway's part: clear bit 30 of 1005h there"

    def heard(self, node_id: int) -> None:
        """Take note of a heartbeat."""
        self._known.add(node_id)

    def take(self, base: int, node_id: int, data: bytes, now_s: float) -> None:
        """Use a frame whose identifier is `base` + `node_id`, of a device or of another master."""
        self._questions.take(base, node_id, data, now_s)

    def find_producers(self, now_s: float) -> None:
        """Ask all devices, one after another, if that was not done a short while ago."""
        if now_s >= self._again_s and self._questions.done:
            self._again_s = now_s + AGAIN_S
            self._questions.ask(sorted(self._known))

    def tick(self, now_s: float) -> bool:
        """Go on with the questions; tell whether the last has just ended with new `words`."""
        if self._questions.done:
            return False
        for node_id, dialogue in self._questions.tick(now_s).items():
            self._producers.discard(node_id)
            if dialogue.result is True:
                self._producers.add(node_id)
        if not self._questions.under_way:
            self._questions.begin(now_s)
        if not self._questions.done or self.words == self._told:
            return False
        self._told = self.words
        return True


def _ask(_node_id: int) -> Dialogue:
    return produces_sync(int.from_bytes((yield Read(od.SYNC_COB_ID, 0, od.UNSIGNED32)), "little"))
