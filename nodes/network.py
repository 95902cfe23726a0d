"""The ``canopen`` library's network on a link of ours: it sends through the link and is fed by the segment."""

import canopen

from bus.link import Link
from dbc.frame import frames


class SegmentNetwork(canopen.Network):
    """A network without a bus thread of its own."""

    def __init__(self, link: Link) -> None:
        super().__init__()
        self._link = link
        self.frames_refused = 0

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:  # noqa: ARG002
        """Send one classic frame; a full transmit queue is counted, not raised."""
        self.send_pdo(can_id, data, 0)

    def send_pdo(self, can_id: int, data: bytes, flags: int) -> None:
        """Send one frame with the `flags` of its kind (`dbc.frame`); a full transmit queue is counted."""
        frame = frames(1)
        frame["can_id"] = can_id
        frame["length"] = len(data)
        frame["flags"] = flags
        frame["port"] = can_id & 0x7F
        frame["data"][0, : len(data)] = tuple(data)
        self.frames_refused += 1 - self._link.send(frame)
