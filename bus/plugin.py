"""``can.Bus(interface="canskin", channel="bus0")``: the virtual bus for programs that use python-can."""

import os
import select
import threading
import time
from collections import deque
from collections.abc import Sequence
from typing import Any, Final

import can
from can.typechecking import AutoDetectedConfig, CanFilters, Channel

from bus.arbitrated import ArbitratedLink
from bus.error_frames import State
from bus.link import ARBITRATED
from bus.messages import to_frame, to_message
from bus.protocol import Hello, runtime_folder
from canskin.errors import SkinError
from dbc.frame import ECHO, ERROR
from shell.clock import wall_offset

#: Period in which a waiting sender checks the transmit queue; `receive` in another thread makes space.
_ROOM_POLL_S: Final = 0.001
_STATE_OF: Final = {
    State.ACTIVE: can.BusState.ACTIVE,
    State.WARNING: can.BusState.ACTIVE,
    State.PASSIVE: can.BusState.PASSIVE,
    State.BUS_OFF: can.BusState.ERROR,
    State.LOST: can.BusState.ERROR,
}


class ArbitratedBus(can.BusABC):
    """One controller on a bus of `skin bus`.

    Parameters
    ----------
    channel : str
        Name of the bus.
    bitrate, data_bitrate : int, optional
        The bus refuses other bit rates than its own.
    fd : bool
        Allow CAN FD frames.
    receive_own_messages : bool
        Receive the messages that this object sent, too, with ``is_rx`` False.
    name : str
        Name by which faults of the bus select this connection.
    wait_s : float
        Longest wait for a bus that is still starting.

    Raises
    ------
    can.CanInitializationError
        If the bus is not served, or refuses the connection.
    """

    def __init__(
        self,
        channel: Channel,
        can_filters: CanFilters | None = None,
        *,
        bitrate: int | None = None,
        fd: bool = False,
        data_bitrate: int | None = None,
        receive_own_messages: bool = False,
        name: str = "python-can",
        wait_s: float = 0.0,
        **_kwargs: Any,
    ) -> None:
        hello = Hello(name=name, bitrate=bitrate, data_bitrate=data_bitrate, fd=fd)
        try:
            self._link = ArbitratedLink(str(channel), hello, wait_s=wait_s)
        except SkinError as error:
            raise can.CanInitializationError(str(error)) from error
        self.channel_info = f"canskin {channel}"
        self._channel = str(channel)
        self._own = receive_own_messages
        self._can_protocol = can.CanProtocol.CAN_FD if fd else can.CanProtocol.CAN_20
        self._lock = threading.Lock()
        self._messages: deque[can.Message] = deque(maxlen=65536)
        # Readable while messages wait that another thread has taken from the link.
        self._waiting = os.eventfd(0, os.EFD_NONBLOCK)
        self._epoll = select.epoll()
        self._epoll.register(self._link.fileno(), select.EPOLLIN)
        self._epoll.register(self._waiting, select.EPOLLIN)
        super().__init__(channel, can_filters)

    def fileno(self) -> int:
        """Return a file descriptor that is readable while messages wait."""
        return self._epoll.fileno()

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Queue a message for transmission.

        Parameters
        ----------
        timeout : float, optional
            Longest wait for space in the transmit queue, seconds; default: no wait.

        Raises
        ------
        can.CanOperationError
            If the transmit queue is full, the controller is bus-off, or the bus is gone.
        """
        frame = to_frame(msg, 0)
        until_s = time.monotonic() + (timeout or 0.0)
        while True:
            self._check(sending=True)
            try:
                if self._link.send(frame):
                    return
            except SkinError as error:
                raise can.CanOperationError(str(error)) from error
            if time.monotonic() >= until_s:
                raise can.CanOperationError("transmit queue full")
            self._pump()
            time.sleep(_ROOM_POLL_S)

    def shutdown(self) -> None:
        """Leave the bus."""
        if self._is_shutdown:
            return
        super().shutdown()
        with self._lock:
            self._epoll.close()
            self._link.close()
            os.close(self._waiting)

    @property
    def state(self) -> can.BusState:
        """ACTIVE, PASSIVE, or ERROR (bus-off, or the bus is gone)."""
        return _STATE_OF[self._link.state]

    @state.setter
    def state(self, _new: can.BusState) -> None:
        raise NotImplementedError("the state of a controller follows from its error counters")

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        until_s = None if timeout is None else time.monotonic() + timeout
        while True:
            message = self._pump(take=True)
            if message is not None:
                return message, False
            self._check()
            left_s = None if until_s is None else until_s - time.monotonic()
            if left_s is not None and left_s <= 0:
                return None, False
            self._epoll.poll(left_s, 1)

    def _check(self, *, sending: bool = False) -> None:
        if self._is_shutdown:
            raise can.CanOperationError("the bus has been shut down")
        if self._link.state is State.LOST:
            raise can.CanOperationError(f"{self.channel_info}: the process that serves the bus is gone")
        if sending and self._link.state is State.BUS_OFF:
            raise can.CanOperationError(f"{self.channel_info}: bus-off")

    def _pump(self, *, take: bool = False) -> can.Message | None:
        """Move received frames from the link to the queue; with `take`, return the oldest message."""
        with self._lock:
            if not self._messages or not take:
                offset_ns = wall_offset().ns
                for record in self._link.receive():
                    flags = record["flags"]
                    if not flags & ECHO or (self._own and not flags & ERROR):
                        self._messages.append(to_message(record, self._channel, offset_ns))
                if self._messages:
                    os.eventfd_write(self._waiting, 1)
            if not take or not self._messages:
                return None
            message = self._messages.popleft()
            if not self._messages:
                os.eventfd_read(self._waiting)
            return message

    @staticmethod
    def _detect_available_configs() -> Sequence[AutoDetectedConfig]:
        """Return the buses with a socket in the runtime folder."""
        return [{"interface": ARBITRATED, "channel": path.stem} for path in sorted(runtime_folder().glob("*.can"))]
