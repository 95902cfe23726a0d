"""The options of a run, checked before any process is started."""

from dataclasses import dataclass
from pathlib import Path

from canskin.errors import InputError
from skin.layout import Layout, require_one_state
from skin.output import check_picture_path
from skin.service import listen
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
            listen("127.0.0.1", self.port).close()
        check_picture_path(self.picture)
        self.touch.check()
        self.touch.defects(layout)
        if self.touch.input is not None:
            self.touch.source(layout)  # the nodes will read the recording again
        elif self.touch.names:
            checked_names(self.touch.names)
