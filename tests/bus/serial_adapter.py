"""A serial CAN adapter on a pseudo-terminal, which can be unplugged and plugged again."""

import os
import pty
import select
import tty
from pathlib import Path

import numpy as np

from dbc.frame import Frames, frames
from tests.bus.harness import frame
from tests.processes import PATIENCE_S


class SerialAdapter:
    """The bus's side of an adapter that speaks slcan, data frames with 11-bit identifiers alone.

    Attributes
    ----------
    path : Path
        The device file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.plug()

    def plug(self) -> None:
        """Make the device file."""
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self._line = b""
        self.path.symlink_to(os.ttyname(self._slave))

    def unplug(self) -> None:
        """Remove the device file and hang up."""
        self.path.unlink()
        os.close(self._slave)
        os.close(self._master)

    def fileno(self) -> int:
        """Return a file descriptor that is readable when the adapter is told something."""
        return self._master

    def receive(self) -> Frames:
        """Return the frames that the adapter was told to send; never wait."""
        try:
            self._line += os.read(self._master, 1 << 16)
        except BlockingIOError:
            return frames(0)
        *whole, self._line = self._line.split(b"\r")
        told = [each for each in whole if each.startswith(b"t")]
        return np.concatenate(
            [frames(0), *(frame(int(each[1:4], 16), bytes.fromhex(each[5:].decode())) for each in told)]
        )

    def await_frames(self) -> Frames:
        """Wait for frames that the adapter is told to send, and return them."""
        while not len(arrived := self.receive()):
            assert select.select([self._master], [], [], PATIENCE_S)[0]
        return arrived

    def send(self, burst: Frames) -> int:
        """Tell the host of frames that came from the bus."""
        for each in burst:
            data = each["data"][: each["length"]].tobytes()
            os.write(self._master, b"t%03X%d%s\r" % (each["can_id"], len(data), data.hex().upper().encode()))
        return len(burst)
