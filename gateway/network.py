"""The ``canopen`` library's master network on a link of ours, fed by the gateway's receive loop."""

import threading

import canopen

from bus.link import Link
from dbc.frame import Frames, frames


class MasterNetwork(canopen.Network):
    """A network without a bus thread of its own; sending is safe from several threads."""

    def __init__(self, link: Link) -> None:
        super().__init__()
        self._link = link
        self._sending = threading.Lock()

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:  # noqa: ARG002
        """Send one frame; a full transmit queue is not raised."""
        frame = frames(1)
        frame["can_id"] = can_id
        frame["length"] = len(data)
        frame["data"][0, : len(data)] = tuple(data)
        self.send_frames(frame)

    def send_frames(self, burst: Frames) -> int:
        """Send frames as they are; return how many the transmit queue took."""
        with self._sending:
            return self._link.send(burst)
