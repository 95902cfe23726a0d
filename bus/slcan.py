"""An adapter on a serial line (slcan), to which no write waits for longer than a limit."""

from can.exceptions import error_check
from can.interfaces.slcan import slcanBus

from bus.python_can import SEND_S


class BoundedSlcan(slcanBus):
    """python-can's slcan with a limit for its commands, and without waits until the line is empty, which have none."""

    def _write(self, string: str) -> None:
        with error_check("Could not write to serial device"):
            self.serialPortOrig.write_timeout = SEND_S
            self.serialPortOrig.write(string.encode() + self.LINE_TERMINATOR)
