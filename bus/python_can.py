"""The link to any interface of python-can, for adapters without SocketCAN driver."""

import contextlib
import logging
import os
import threading
import time
from collections import deque
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

import can
import numpy as np

from bus.bit_timing import choose_timing
from bus.error_frames import State
from bus.messages import to_frame, to_message
from bus.protocol import check_frames, in_time
from bus.reconnecting import FIRST_S, LONGEST_S, QUEUE_FULL
from canskin.errors import BusError, InputError
from dbc.frame import ECHO, Frames, frames

#: A value of an option of an interface.
Value = str | int | float | bool

#: Most frames kept until `receive`; later frames are lost and counted.
QUEUE_FRAMES: Final = 16384
FRAMES_PER_CALL: Final = 1024
#: Longest wait for room on a serial line: the loop of the gateway waits, too.
SEND_S: Final = 0.05
#: An interface that is bus-off, or takes no frame, for this time is opened again: that ends bus-off.
PATIENCE_S: Final = 1.0


class _Interface(NamedTuple):
    """What an interface of python-can is like."""

    #: What to install besides python-can.
    needs: str = ""
    #: Arguments that it needs here; those of the user come before them.
    options: Mapping[str, Value] = {}
    #: Takes the bit timing of CAN FD; the others take the rates.
    takes_timing: bool = False
    #: Its echo of a frame is the controller's report that the frame has been sent (CANlib's TXACK), at its place among
    #: the received frames.
    proves_echo: bool = False
    #: Waits for ever for room on a serial line unless it gets a limit. After a failure a part of a frame may be on the
    #: line: only a new beginning tells the adapter where the next frame begins.
    is_serial: bool = False


_PYSERIAL: Final = "pip install pyserial"
_INTERFACES: Final[Mapping[str, _Interface]] = {
    "gs_usb": _Interface("pip install gs_usb pyusb, and libusb-1.0"),
    "kvaser": _Interface(
        "Kvaser's linuxcan (libcanlib.so)", {"receive_own_messages": True}, takes_timing=True, proves_echo=True
    ),
    "neovi": _Interface("pip install python-ics"),
    "nixnet": _Interface(takes_timing=True),
    # Without auto_reset it stays bus-off.
    "pcan": _Interface("PEAK's PCAN-Basic (libpcanbasic.so) and its driver", {"auto_reset": True}, takes_timing=True),
    "robotell": _Interface(_PYSERIAL, is_serial=True),
    "slcan": _Interface(_PYSERIAL, takes_timing=True, is_serial=True),
    "udp_multicast": _Interface("pip install msgpack"),
    "vector": _Interface(takes_timing=True),
}
#: Clock for which the bit timing of CAN FD is computed; an interface with another clock converts it.
_FD_CLOCK_HZ: Final = 80_000_000
_STATE_OF: Final = {
    can.BusState.ACTIVE: State.ACTIVE,
    can.BusState.PASSIVE: State.PASSIVE,
    can.BusState.ERROR: State.BUS_OFF,
}
#: What interfaces raise that refuse a frame, or do not tell their state. After any other exception they are lost.
_REFUSES: Final = (can.CanError, OSError, ValueError, TypeError, NotImplementedError, LookupError)
# Opening tells what is missing, in one line; what python-can logs besides would go to stderr.
logging.getLogger("can").addHandler(logging.NullHandler())
can.interfaces.BACKENDS |= {"slcan": ("bus.slcan", "BoundedSlcan"), "udp_multicast": ("bus.multicast", "OneGroup")}


class PythonCanLink:
    """A python-can bus as a link, read by a thread. An interface that was lost is opened again.

    Where the interface has no proven echo, the echo of a frame comes when the frame is handed over, before all frames
    that are received later. A frame that the interface refused has no echo, and may have been sent all the same. An
    adapter on a serial line that takes no frame for `SEND_S` is lost.

    Parameters
    ----------
    options : mapping of str to Value, optional
        Arguments of the interface, as python-can documents them.

    Raises
    ------
    InputError
        If no bit timing makes the rates.
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
        options: Mapping[str, Value] | None = None,
    ) -> None:
        self._interface, self._channel, self._fd = interface, channel, fd
        self._kind = kind = _INTERFACES.get(interface, _Interface())
        self._arguments = _arguments(kind, bitrate, data_bitrate or bitrate, dict(options or {}), fd=fd)
        self._send_options = {"timeout": SEND_S} if kind.is_serial else {}
        self._proves_echo = kind.proves_echo and not self._arguments.get("single_handle")
        self.dropped = 0
        self._queue: deque[Frames] = deque()
        #: Held while a frame is handed over, while a frame is put into the queue, and while `_bus` changes.
        self._lock = threading.RLock()
        self._closing = threading.Event()
        #: Since when the interface takes no frame, and since when it is bus-off.
        self._refuses_s: float | None = None
        self._is_off_s: float | None = None
        self._why_lost = ""
        self._bus: can.BusABC | None = self._open()
        self._wake = os.eventfd(0, os.EFD_NONBLOCK)
        self._thread = threading.Thread(target=self._run, name=f"read {channel}", daemon=True)
        self._thread.start()

    def fileno(self) -> int:
        """Return a file descriptor that is readable while frames wait."""
        return self._wake

    @property
    def proves_echo(self) -> bool:
        """Whether the echo of a frame is the controller's report, if the interface proves that."""
        return self._proves_echo

    @property
    def stamp_error_ns(self) -> int | None:
        """None: times are those at which frames were read, because clocks of adapters are of unknown error."""
        return None

    @property
    def state(self) -> State:
        """State of the controller, from the interface; LOST while there is no interface."""
        bus = self._bus
        if bus is None:
            return State.LOST
        try:
            state = _STATE_OF[bus.state]
        except _REFUSES:
            return State.ACTIVE  # many interfaces do not tell
        except Exception:  # noqa: BLE001
            self._lose(bus)  # or the reader shuts it down
            return State.LOST
        self._is_off_s = None if state is not State.BUS_OFF else self._is_off_s or time.monotonic()
        return state

    def explain(self) -> str:
        """Return why the interface is not opened again, or takes no frame."""
        if self._bus is None:
            return self._why_lost
        return "" if self._refuses_s is None else QUEUE_FULL

    def receive(self) -> Frames:
        """Return all waiting frames, echoes of sent frames included."""
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
            with self._lock:
                bus = self._bus
                if bus is None:
                    return place
                try:
                    bus.send(message, **self._send_options)
                except Exception as error:  # noqa: BLE001
                    self._refuses_s = self._refuses_s or time.monotonic()
                    if self._send_options or not isinstance(error, _REFUSES):
                        self._lose(bus)
                    return place
                self._refuses_s = None
                if not self._proves_echo:
                    self._put_echo(burst[place : place + 1])
        return len(burst)

    def close(self) -> None:
        """End the reader and close the interface."""
        if self._closing.is_set():
            return
        self._closing.set()
        self._thread.join()
        os.close(self._wake)

    def _open(self) -> can.BusABC:
        # Channels of digits are numbers: gs_usb takes no text.
        channel = int(self._channel) if self._channel.isdecimal() else self._channel
        try:
            return can.Bus(channel=channel, interface=self._interface, ignore_config=True, **self._arguments)
        except Exception as error:
            raise BusError(
                f"cannot open {self._channel} of python-can's interface '{self._interface}': "
                f"{_why(error, self._kind.needs)}"
            ) from error

    def _run(self) -> None:
        """Read until `close`; open a lost interface again, after waits that grow."""
        bus, wait_s = self._bus, FIRST_S
        while not self._closing.is_set():
            if bus is None:
                if not self._closing.wait(wait_s):
                    try:
                        bus = self._bus = self._open()
                        wait_s = FIRST_S
                    except BusError as error:
                        self._why_lost = str(error)
                        wait_s = min(2 * wait_s, LONGEST_S)
            elif bus is self._bus:
                self._take(bus)
            else:
                _shut_down(bus)
                bus = None
        self._bus = None
        if bus is not None:
            _shut_down(bus)

    def _take(self, bus: can.BusABC) -> None:
        """Take the messages that wait; wait for the first."""
        now_s = time.monotonic()
        if any(since_s is not None and now_s - since_s > PATIENCE_S for since_s in (self._refuses_s, self._is_off_s)):
            self._lose(bus)
            return
        try:
            for place in range(FRAMES_PER_CALL):
                message = bus.recv(0.0 if place else 0.1)
                if message is None:
                    return
                if message.is_rx or self._proves_echo:
                    self._take_one(message)
        except (ValueError, LookupError, OverflowError):  # what came is no frame, as on a serial line after noise
            self.dropped += 1
        except Exception:  # noqa: BLE001
            self._lose(bus)

    def _take_one(self, message: can.Message) -> None:
        frame = to_frame(message, time.monotonic_ns())
        if not message.is_rx:
            frame["flags"] |= ECHO
        with self._lock:
            self._put(frame)

    def _lose(self, bus: can.BusABC) -> None:
        """Use an interface no longer, because it is gone or does not work; the reader shuts it down."""
        with self._lock:
            if bus is self._bus:
                self._bus = None
                self._refuses_s = self._is_off_s = None
                self.dropped += 1  # what came meanwhile: the gap is told however short it is

    def _put_echo(self, frame: Frames) -> None:
        echo = frame.copy()
        echo["flags"] |= ECHO
        echo["time_ns"], echo["expires_ns"] = time.monotonic_ns(), 0
        self._put(echo)

    def _put(self, frame: Frames) -> None:
        if len(self._queue) >= QUEUE_FRAMES:
            self.dropped += 1
            return
        self._queue.append(frame)
        os.eventfd_write(self._wake, 1)


def _shut_down(bus: can.BusABC) -> None:
    with contextlib.suppress(Exception):
        bus.shutdown()


def _arguments(
    kind: _Interface, bitrate: int, data_bitrate: int, options: dict[str, Value], *, fd: bool
) -> dict[str, Any]:
    """Return the arguments of `can.Bus`; `options` come before what is set here."""
    rates: dict[str, Any] = {"bitrate": bitrate}
    if fd:
        rates |= {"fd": True, "data_bitrate": data_bitrate}
        if kind.takes_timing and not {"f_clock", "f_clock_mhz"} & options.keys():
            rates["timing"] = choose_timing(_FD_CLOCK_HZ, [bitrate, data_bitrate])
            if rates["timing"] is None:
                raise InputError(
                    f"expected bit rates that a clock of {_FD_CLOCK_HZ / 1e6:g} MHz can make, got {bitrate / 1e3:g} "
                    f"and {data_bitrate / 1e3:g} kbit/s: change the layout, or give the adapter's clock and segments "
                    "with --bus-option f_clock_mhz=..."
                )
    return rates | dict(kind.options) | options


def _why(error: Exception, needs: str) -> str:
    """Return the reason of an error of an interface, and what to install if that is missing."""
    reason = " ".join(str(error).split())
    is_missing = isinstance(error, (ImportError, can.CanInterfaceNotImplementedError, NameError))
    is_missing |= "library not found" in reason  # PCAN-Basic
    return f"{reason}; it needs {needs}" if is_missing and needs else reason
