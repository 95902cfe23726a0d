"""SDO requests of another master to a node: a doubt for the gateway, a channel in use, or nothing.

A board that hangs may answer the gateway's question of before a write after the write. So the answers that are still to
come at a write that counts are not used, and the gateway asks again. A question that a stopped node never answered is
still open then, and costs one more question.
"""

from collections import Counter
from collections.abc import Mapping
from enum import Enum, auto
from typing import Final

from dbc.canopen import SDO_BLOCKS_TAKEN
from gateway.sdo import ATTEMPTS

#: What the proof compares.
CONFIGURATION: Final = "configuration"
GAINS: Final = "gains or offsets (2010h, 2011h)"
#: After another client's request the gateway leaves the node's SDO channel alone for this long.
SDO_QUIET_S: Final = 0.05
#: A block download of another master has ended when no frame of it comes for this long.
BLOCK_DOWNLOAD_S: Final = 1.0
#: First byte of an abort (CiA 301, 7.2.4.3.17); no segment of a block download begins with it.
_ABORT: Final = 0x80


class Effect(Enum):
    """Meaning of one request."""

    #: The request asks for nothing: the end of a transfer.
    NONE = auto()
    #: The node answers one client at a time.
    BUSY = auto()
    #: An object that the proof compares is written.
    DOUBT = auto()


class ForeignClient:
    """The SDO requests of other masters to one node.

    Parameters
    ----------
    compared : mapping of int to str
        Indices of the objects that the proof compares, and what they are.

    Attributes
    ----------
    written : str
        What the newest doubtful write is to.
    """

    def __init__(self, compared: Mapping[int, str]) -> None:
        self._compared = compared
        self.written = CONFIGURATION
        self._heard_s = float("-inf")
        self._is_suspect = True
        self._in_block_download = False
        #: By the object's place in a request: reads of the gateway without an answer, and those of before a write.
        self._open: Counter[bytes] = Counter()
        self._old: Counter[bytes] = Counter()

    @property
    def free_s(self) -> float:
        """When the gateway may use the node's SDO channel again."""
        return self._heard_s + SDO_QUIET_S

    def take(self, data: bytes, now_s: float) -> Effect:
        """Tell what a request means."""
        kind = data[0] >> 5
        if data[0] == _ABORT:
            self._in_block_download = False
        # The first byte of a block's data is a number, not a kind. But the node may never have heard of the block
        # download. So each frame of it is read both ways, and one of them is enough for a doubt.
        may_be_data = self._in_block_download and now_s - self._heard_s < BLOCK_DOWNLOAD_S
        self._in_block_download = may_be_data or kind == 6
        self._heard_s = now_s
        if kind in (1, 6):  # a download begins, in segments or blocks
            written = self._compared.get(int.from_bytes(data[1:3], "little"))
            self.written = written or self.written
            self._is_suspect = written is not None or (may_be_data and self._is_suspect)
        if (may_be_data or kind in (0, 1, 6)) and self._is_suspect:
            self._old |= self._open
            return Effect.DOUBT
        return Effect.BUSY if kind else Effect.NONE

    def ask(self, data: bytes) -> None:
        """Take note of a request of the gateway; of one object the attempts of one transfer count."""
        place = data[1:4]
        if data[0] >> 5 == 2:  # an upload begins
            self._open[place] = min(self._open[place] + 1, ATTEMPTS)

    def take_answer(self, data: bytes) -> bool:
        """Take note of an answer; tell whether the answer may be older than a write that counts.

        An answer that ends or refuses a block download ends it: what follows are requests again.
        """
        if data[0] in (_ABORT, SDO_BLOCKS_TAKEN):
            self._in_block_download = False
        if data[0] >> 5 not in (2, 4):  # neither the answer to an upload nor an abort
            return False
        place = data[1:4]
        is_old = self._old[place] > 0
        self._open -= Counter((place,))
        self._old -= Counter((place,))
        return is_old

    def booted(self) -> None:
        """Take note of the boot-up message of the node, after which no older answer comes."""
        self._open.clear()
        self._old.clear()
