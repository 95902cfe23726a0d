"""What nodes are tested with in place of a bus and of a touch."""

import numpy as np

from dbc.contract import Contract
from dbc.frame import ECHO, Frames, frames
from skin.sources import Frame


class ArrayLink:
    """Keeps what nodes send, and echoes it as a bus without traffic would.

    What is tested here is what nodes make of frames, not a bus.
    """

    def __init__(self) -> None:
        self.sent: list[Frames] = []
        self.waiting: list[Frames] = []
        #: Frames that a send finds room for.
        self.room = 1 << 30

    def receive(self) -> Frames:
        arrived = np.concatenate(self.waiting) if self.waiting else frames(0)
        self.waiting.clear()
        return arrived

    def send(self, burst: Frames) -> int:
        taken = burst[: self.room].copy()
        self.sent.append(taken)
        echo = taken.copy()
        echo["flags"] |= ECHO
        self.waiting.append(echo)
        return len(taken)

    def take_sent(self) -> Frames:
        out = np.concatenate(self.sent) if self.sent else frames(0)
        self.sent.clear()
        return out


class Still:
    """A source with the same touch for ever."""

    has_noise = True

    def __init__(self, contract: Contract) -> None:
        taxels = contract.layout.taxels
        random = np.random.default_rng(1)
        self.force_n = random.uniform(0, taxels.force_max_n, (taxels.rows, taxels.columns)).astype(np.float32)

    def frame(self, step: int) -> Frame:
        return Frame(self.force_n, "")
