"""The options of a run, checked before any process is started."""

import errno
import socket
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from canskin.errors import InputError
from skin.defects import parse_defects
from skin.layout import Layout, require_one_state
from skin.output import check_picture_path
from skin.recording_options import check_touch_options, load_recording
from skin.sources import StrokeKind
from skin.zero_drift import parse_drifts
from touch.objects import checked_names

#: Defects with which an untouched skin has sums.
_ZERO_DEFECTS: Final = ("offset", "drift", "sum_offset")


@dataclass(frozen=True)
class DemoOptions:
    """The options of `demo.command.demo`, with the same names; empty `objects` for the default series."""

    layout_path: Path | None
    seconds: float
    recording: Path | None
    full_scale: float | None
    arrays: tuple[str, ...]
    rate_hz: float | None
    objects: tuple[str, ...]
    defects: tuple[str, ...]
    seed: int
    view: bool
    port: int | None
    listen: str | None
    picture: Path
    firmware: bool = False
    stroke: StrokeKind = "slide"
    drifts: tuple[str, ...] = ()

    @property
    def has_zero_errors(self) -> bool:
        """Whether taxels may read something without touch, apart from noise, so that the gateway has to tare."""
        defects = parse_defects(self.defects, self.seed, is_analogue=True)
        return self.recording is not None or bool(self.drifts) or not defects.keys().isdisjoint(_ZERO_DEFECTS)

    def check(self, layout: Layout) -> None:
        """Check that a run with these options is possible.

        Raises
        ------
        InputError
            If an option cannot be used.
        """
        if not 0 < self.seconds < float("inf"):
            raise InputError(f"expected a positive number of seconds, got {self.seconds:g}")
        if self.seed < 0:
            raise InputError(f"--seed: expected 0 or more, got {self.seed}")
        if self.firmware:
            require_one_state(layout, "the firmware in C")
        if len({(bus.bitrate, bus.data_bitrate or bus.bitrate) for bus in layout.bus}) > 1:
            raise InputError("the demo's virtual buses all have the same bit rates; this layout has several")
        if self.view and self.port is not None:
            _check_port(self.port)
        check_picture_path(self.picture)
        parse_defects(self.defects, self.seed, is_analogue=layout.taxels.is_analogue)
        parse_drifts(self.drifts, self.seed, layout)
        self._check_touch(layout)

    def _check_touch(self, layout: Layout) -> None:
        """Check the objects, or the recording, which the nodes will read again."""
        values = self.full_scale, self.arrays, self.rate_hz
        check_touch_options(self.recording, self.stroke, *values)
        if self.recording is not None:
            load_recording(layout, self.recording, *values)
        elif self.objects:
            checked_names(",".join(self.objects))


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
