"""The options of a run, checked before any process is started."""

import errno
import socket
from dataclasses import dataclass
from pathlib import Path

from canskin.errors import InputError
from skin.layout import Layout, require_one_state
from skin.output import check_picture_path
from skin.touch_options import TouchOptions
from touch.objects import checked_names


@dataclass(frozen=True)
class DemoOptions:
    """The options of `demo.command.demo`, with the same names."""

    layout_path: Path | None
    seconds: float
    touch: TouchOptions
    view: bool
    port: int | None
    listen: str | None
    picture: Path
    firmware: bool = False

    def has_zero_errors(self, layout: Layout) -> bool:
        """Tell whether taxels may read something without touch, apart from noise, so that the gateway has to tare."""
        return self.touch.input is not None or self.touch.defects(layout).moves_zero

    def check(self, layout: Layout) -> None:
        """Check that a run with these options is possible.

        Raises
        ------
        InputError
            If an option cannot be used.
        """
        if not 0 < self.seconds < float("inf"):
            raise InputError(f"expected a positive number of seconds, got {self.seconds:g}")
        if self.firmware:
            require_one_state(layout, "the firmware in C")
        if len({(bus.bitrate, bus.data_bitrate or bus.bitrate) for bus in layout.bus}) > 1:
            raise InputError("the demo's virtual buses all have the same bit rates; this layout has several")
        if self.view and self.port is not None:
            _check_port(self.port)
        check_picture_path(self.picture)
        self.touch.check()
        self.touch.defects(layout)
        if self.touch.input is not None:
            self.touch.source(layout)  # the nodes will read the recording again
        elif self.touch.names:
            checked_names(self.touch.names)


def _check_port(port: int) -> None:
    if not 0 <= port <= 65535:
        raise InputError(f"--port: expected 0 to 65535, got {port}")
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                raise InputError(f"--port {port}: cannot listen there: {error.strerror or error}") from error
            raise InputError(f"port {port} is in use: give another with --port, or --port 0 for a free one") from error
