"""The commands and SDO requests of the master of one bus, few at a time in the transmit queue."""

from collections import deque
from typing import Final

from bus.link import Send
from dbc.frame import Frames, one_frame
from gateway.sdo import TIMEOUT_S

#: Most frames between the send call and their echoes. SocketCAN's queue has room for 10 unless somebody changes it.
UNDER_WAY: Final = 4
#: An echo that has not come by then is lost: a full bus delays no frame by that long.
LOST_S: Final = 3.0
#: After this time a frame counts as sent where echoes tell nothing, as those of a driver without IFF_ECHO.
UNTOLD_S: Final = 0.01


class Outgoing:
    """Sends frames in their order, at most `UNDER_WAY` at a time: SYNC always finds room in the transmit queue.

    A frame that the queue refuses is sent when the queue has room. A frame that has waited for `TIMEOUT_S` is dropped:
    its sender has sent it again, or given up.

    Parameters
    ----------
    send : callable
    now_s : float
    has_echoes : bool
        Whether an echo comes when its frame has been on the bus (`bus.link.Link.proves_echo`).
    """

    def __init__(self, send: Send, now_s: float, *, has_echoes: bool = True) -> None:
        self._send = send
        self._has_echoes = has_echoes
        self._now_s = now_s
        #: With the times since when they wait.
        self._waiting: deque[tuple[float, Frames]] = deque()
        #: Times of the frames whose echoes have not come.
        self._under_way: deque[float] = deque()

    def put(self, can_id: int, data: bytes) -> None:
        """Send a classic frame, now or as soon as it may go."""
        self._waiting.append((self._now_s, one_frame(can_id, data)))
        self.flush()

    def take(self, echoes: int, *, has_gap: bool) -> None:
        """Count echoes; send what waited for them.

        Parameters
        ----------
        echoes : int
            See `gateway.batch.Batch`.
        has_gap : bool
            Whether frames, and so echoes, may have been lost.
        """
        if not self._under_way or not (self._has_echoes or has_gap):
            return
        for _ in range(len(self._under_way) if has_gap else min(echoes, len(self._under_way))):
            self._under_way.popleft()
        self.flush()

    def tick(self, now_s: float) -> None:
        """Drop what is too old, and send what may go; call it many times a second."""
        self._now_s = now_s
        if not self._waiting and not self._under_way:
            return
        while self._waiting and now_s - self._waiting[0][0] > TIMEOUT_S:
            self._waiting.popleft()
        while self._under_way and now_s - self._under_way[0] > (LOST_S if self._has_echoes else UNTOLD_S):
            self._under_way.popleft()
        self.flush()

    def flush(self, most: int = UNDER_WAY) -> bool:
        """Send what may go while `most` frames are under way; tell whether frames still wait."""
        while self._waiting and len(self._under_way) < most and self._send(self._waiting[0][1]):
            self._waiting.popleft()
            self._under_way.append(self._now_s)
        return bool(self._waiting)
