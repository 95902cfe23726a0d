"""The ``canopen`` library's network without a bus: sends by a function; the segment hands it received frames."""

import canopen

from bus.link import Send
from dbc.frame import one_frame


class SegmentNetwork(canopen.Network):
    """A network without a thread for the bus; frames that the full transmit queue refuses are dropped.

    Attributes
    ----------
    pdos_sent, pdos_dropped : int
        PDOs that the transmit queue accepted, and PDOs that it refused.
    """

    def __init__(self, send: Send) -> None:
        super().__init__()
        self._send_frames = send
        self.pdos_sent = self.pdos_dropped = 0

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:  # noqa: ARG002
        """Send one classic frame."""
        self._send(can_id, data, 0)

    def send_pdo(self, can_id: int, data: bytes, flags: int) -> bool:
        """Send a PDO in a frame with `flags` (`dbc.frame`); tell whether the transmit queue accepted it."""
        accepted = self._send(can_id, data, flags)
        self.pdos_sent += accepted
        self.pdos_dropped += 1 - accepted
        return bool(accepted)

    def _send(self, can_id: int, data: bytes, flags: int) -> int:
        frame = one_frame(can_id, data, flags)
        frame["port"] = can_id & 0x7F
        return self._send_frames(frame)
