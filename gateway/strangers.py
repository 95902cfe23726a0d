"""Devices on the bus that are no boards of the skin: which of them say that they produce SYNC."""

from collections.abc import Callable
from typing import Final

from dbc import indices as od
from dbc.canopen import BASE_ID_MASK, SDO_BYTES, SYNC_COB_ID
from gateway.sdo import Dialogue, Read, SdoDialogue
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
        self._send = send
        self._known: set[int] = set()
        self._left: list[int] = []
        self._asked: tuple[int, SdoDialogue] | None = None
        self._again_s = float("-inf")
        self._producers: set[int] = set()

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

    def answered(self, node_id: int, data: bytes, now_s: float) -> None:
        """Take an SDO response."""
        if self._asked is not None and self._asked[0] == node_id and len(data) == SDO_BYTES:
            self._asked[1].take(data, now_s)

    def find_producers(self, now_s: float) -> None:
        """Ask all devices, one after another, if that was not done a short while ago."""
        if now_s >= self._again_s and self._asked is None:
            self._again_s = now_s + AGAIN_S
            self._left = sorted(self._known)

    def tick(self, now_s: float) -> bool:
        """Go on with the questions; tell whether the last answer has just come or been missed."""
        if self._asked is not None:
            node_id, dialogue = self._asked
            dialogue.tick(now_s)
            if not dialogue.done:
                return False
            self._producers.discard(node_id)
            if dialogue.result is True:
                self._producers.add(node_id)
            self._asked = None
            if not self._left:
                return True
        if self._left:
            node_id = self._left.pop(0)
            self._asked = node_id, SdoDialogue(node_id, _ask(), self._send, now_s, attempts=1)
        return False


def _ask() -> Dialogue:
    return produces_sync(int.from_bytes((yield Read(od.SYNC_COB_ID)), "little"))
