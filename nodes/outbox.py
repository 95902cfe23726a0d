"""What the nodes of a bus send, until their segment takes it."""

import canopen
import numpy as np

from dbc.canopen import HIGHEST_NODE_ID
from dbc.frame import Frames, frames, one_frame


class Outbox(canopen.Network):
    """The ``canopen`` library's network without a bus: keeps what nodes send until somebody takes it."""

    def __init__(self) -> None:
        super().__init__()
        self._waiting: list[Frames] = []

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:  # noqa: ARG002
        """Send one classic frame."""
        self.send_pdo(can_id, data, 0)

    def send_pdo(self, can_id: int, data: bytes, flags: int) -> None:
        """Send a PDO in a frame with `flags` (`dbc.frame`)."""
        frame = one_frame(can_id, data, flags)
        frame["port"] = can_id & HIGHEST_NODE_ID
        self.post(frame)

    def post(self, burst: Frames) -> None:
        """Send frames."""
        self._waiting.append(burst)

    def take(self) -> Frames:
        """Return what was sent since the last call."""
        waiting, self._waiting = self._waiting, []
        return waiting[0] if len(waiting) == 1 else np.concatenate([frames(0), *waiting])
