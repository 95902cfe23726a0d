"""An slcan adapter on a pseudo terminal: to the kernel a CAN controller with bit rate, queue and state.

Its bus is a vcan interface. Protocol: Linux ``drivers/net/can/slcan/slcan-core.c``.
"""

import contextlib
import fcntl
import os
import select
import socket
import struct
import subprocess
import termios
import threading
import tty
from typing import Final

N_SLCAN: Final = 17
SIOCGIFNAME: Final = 0x8910
#: Of `Adapter.fill`; the adapter keeps these frames for itself.
FILLER: Final = 0x7FF


class Adapter:
    """An adapter that is plugged in as interface `name`.

    Attributes
    ----------
    reads : bool
        Whether the adapter takes frames from the computer.
    """

    def __init__(self, name: str, bus: str) -> None:
        self.name = name
        self.reads = True
        self._bus = bus
        self._master = self._slave = -1
        self._ended = threading.Event()
        self._thread = threading.Thread()

    def plug(self, *settings: str) -> None:
        """Plug the adapter in; `settings` are those of ``ip link set NAME``."""
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        fcntl.ioctl(self._slave, termios.TIOCSETD, struct.pack("i", N_SLCAN))
        given = fcntl.ioctl(self._slave, SIOCGIFNAME, bytes(16)).rstrip(b"\0").decode()
        self._ended.clear()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()
        subprocess.run(["ip", "link", "set", given, "name", self.name], check=True)
        if settings:
            subprocess.run(["ip", "link", "set", self.name, *settings], check=True)

    def unplug(self) -> None:
        """Pull the adapter out: its interface is deleted."""
        self._ended.set()
        self._thread.join()
        os.close(self._slave)
        os.close(self._master)

    def tell_state(self, state: str, receive_errors: int = 0, transmit_errors: int = 0) -> None:
        """Report a state: a (active), w (warning), p (passive) or b (bus-off)."""
        os.write(self._master, f"s{state}{receive_errors:03}{transmit_errors:03}\r".encode())

    def fill(self) -> None:
        """Stop to read, and fill the transmit queue of the interface."""
        self.reads = False
        with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as sender:
            sender.bind((self.name,))
            sender.setblocking(False)
            with contextlib.suppress(OSError):  # ENOBUFS
                while True:
                    sender.send(struct.pack("=IB3x8s", FILLER, 8, bytes(8)))

    def _run(self) -> None:
        """Carry frames between the computer and the bus."""
        text = b""
        with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as bus:
            bus.bind((self._bus,))
            while not self._ended.is_set():
                ready = select.select([bus, *([self._master] if self.reads else [])], [], [], 0.1)[0]
                if bus in ready:
                    can_id, length, data = struct.unpack("=IB3x8s", bus.recv(16))
                    with contextlib.suppress(BlockingIOError):
                        os.write(self._master, f"t{can_id:03X}{length}{data[:length].hex()}\r".encode())
                if self._master in ready:
                    *lines, text = (text + os.read(self._master, 4096)).split(b"\r")
                    for line in lines:
                        if line[:1] == b"t" and (can_id := int(line[1:4], 16)) != FILLER:
                            data = bytes.fromhex(line[5:].decode())
                            bus.send(struct.pack("=IB3x8s", can_id, len(data), data))
