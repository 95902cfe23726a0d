"""The link to any interface of python-can, for adapters without SocketCAN driver."""

import contextlib
import os
import select
import threading
import time
from collections import deque
from typing import Any, Final

import can
import numpy as np

from bus.error_frames import State
from bus.messages import to_frame, to_message
from bus.protocol import check_frames, in_time
from bus.reconnecting import QUEUE_FULL
from canskin.errors import BusError
from dbc.frame import ECHO, Frames, frames
from shell.clock import wall_offset

#: Most frames kept until `receive`; later frames are lost and counted.
QUEUE_FRAMES: Final = 16384
FRAMES_PER_CALL: Final = 1024
_STATE_OF: Final = {
    can.BusState.ACTIVE: State.ACTIVE,
    can.BusState.PASSIVE: State.PASSIVE,
    can.BusState.ERROR: State.BUS_OFF,
}


class PythonCanLink:
    """A python-can bus as a link.

    Interfaces without a file descriptor are read by a thread. The echo of a sent frame comes when the interface accepts
    the frame, which may be before its transmission.

    Raises
    ------
    BusError
        If python-can cannot open the interface.
    """

    def __init__(
        self,
        interface: str,
        channel: str,
        bitrate: int,
        *,
        fd: bool = False,
        data_bitrate: int | None = None,
    ) -> None:
        options: dict[str, Any] = {"bitrate": bitrate}
        if fd:
            options |= {"fd": True, "data_bitrate": data_bitrate or bitrate}
        try:
            self._bus = can.Bus(channel=channel, interface=interface, ignore_config=True, **options)
        except (can.CanError, OSError, ValueError, TypeError, ImportError, NotImplementedError) as error:
            reason = " ".join(str(error).split())
            raise BusError(f"cannot open {channel} of python-can's interface '{interface}': {reason}") from error
        self.dropped = 0
        self._is_full = False
        self._channel = channel
        self._fd = fd
        self._lost = False
        self._closing = False
        self._queue: deque[Frames] = deque()
        self._wake = os.eventfd(0, os.EFD_NONBLOCK)
        self._epoll = select.epoll()
        self._epoll.register(self._wake, select.EPOLLIN)
        self._thread: threading.Thread | None = None
        self._descriptor = self._bus_fileno()
        if self._descriptor >= 0:
            self._epoll.register(self._descriptor, select.EPOLLIN)
        else:
            self._thread = threading.Thread(target=self._read, name=f"read {channel}", daemon=True)
            self._thread.start()

    def fileno(self) -> int:
        """Return a file descriptor that is readable while frames wait."""
        return self._epoll.fileno()

    @property
    def keeps_order(self) -> bool:
        """False: an echo may come before the transmission of its frame."""
        return False

    @property
    def stamp_error_ns(self) -> int | None:
        """None: the echo of a frame has no time stamp."""
        return None

    @property
    def state(self) -> State:
        """State of the controller, from the interface; LOST if reading has failed."""
        if self._lost:
            return State.LOST
        try:
            return _STATE_OF[self._bus.state]
        except (NotImplementedError, can.CanError):
            return State.ACTIVE  # many interfaces do not tell

    def explain(self) -> str:
        """Return why a frame was refused since the last call, where that is known."""
        was_full, self._is_full = self._is_full, False
        return QUEUE_FULL if was_full else ""

    def receive(self) -> Frames:
        """Return all waiting frames, echoes of sent frames included."""
        if self._thread is None and not self._lost:
            self._take(0.0)
        with contextlib.suppress(BlockingIOError):
            os.eventfd_read(self._wake)
        arrived = [self._queue.popleft() for _ in range(len(self._queue))]
        return np.concatenate(arrived) if arrived else frames(0)

    def send(self, burst: Frames) -> int:
        """Pass frames to the interface; return the number of accepted frames, counted from the first.

        A frame whose latest start has passed is not accepted; in the interface that time has no effect.
        """
        check_frames(burst, fd=self._fd)
        burst = in_time(burst)
        for place, record in enumerate(burst):
            message = to_message(record, self._channel, 0)
            try:
                self._bus.send(message)
            except can.CanError:
                self._is_full = True
                return place
            echo = burst[place : place + 1].copy()
            echo["flags"] |= ECHO
            echo["time_ns"], echo["expires_ns"] = time.monotonic_ns(), 0
            self._put(echo)
        return len(burst)

    def close(self) -> None:
        """End the reader and close the interface."""
        if self._closing:
            return
        self._closing = True
        if self._thread is not None:
            self._thread.join()
        self._epoll.close()
        os.close(self._wake)
        self._bus.shutdown()

    def _bus_fileno(self) -> int:
        try:
            return self._bus.fileno()
        except NotImplementedError:
            return -1

    def _read(self) -> None:
        while not self._closing and not self._lost:
            self._take(0.1)

    def _take(self, timeout_s: float) -> None:
        """Take the messages that wait; wait for the first."""
        offset_ns = 0
        for place in range(FRAMES_PER_CALL):
            message = self._receive(0.0 if place else timeout_s)
            if message is None:
                return
            if not place:
                offset_ns = wall_offset().ns
            self._put(to_frame(message, offset_ns))

    def _receive(self, timeout_s: float) -> can.Message | None:
        try:
            return self._bus.recv(timeout_s)
        except (can.CanError, OSError):
            self._lost = True
            if self._descriptor >= 0:  # else the descriptor would stay readable
                self._epoll.unregister(self._descriptor)
            return None

    def _put(self, frame: Frames) -> None:
        if len(self._queue) >= QUEUE_FRAMES:
            self.dropped += 1
            return
        self._queue.append(frame)
        os.eventfd_write(self._wake, 1)
