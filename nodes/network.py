"""The ``canopen`` library's network on a link of ours: it sends through the link and is fed by the segment."""

import canopen

from bus.link import Link
from dbc.frame import one_frame


class SegmentNetwork(canopen.Network):
    """A network without a bus thread of its own; what finds no room in the transmit queue is dropped.

    Attributes
    ----------
    pdos_sent, pdos_dropped : int
        PDOs that found room, and those that found none.
    """

    def __init__(self, link: Link) -> None:
        super().__init__()
        self._link = link
        self.pdos_sent = self.pdos_dropped = 0

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:  # noqa: ARG002
        """Send one classic frame."""
        self._send(can_id, data, 0)

    def send_pdo(self, can_id: int, data: bytes, flags: int) -> bool:
        """Send a PDO in a frame with the `flags` of its kind (`dbc.frame`); tell whether there was room."""
        accepted = self._send(can_id, data, flags)
        self.pdos_sent += accepted
        self.pdos_dropped += 1 - accepted
        return bool(accepted)

    def _send(self, can_id: int, data: bytes, flags: int) -> int:
        frame = one_frame(can_id, data, flags)
        frame["port"] = can_id & 0x7F
        return self._link.send(frame)
