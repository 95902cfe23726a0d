"""From messages of the fabric to a canvas: images, contacts, curves and log lines."""

from collections.abc import Sequence
from typing import Final, Protocol

import msgspec

from canskin.labels import is_measured
from canskin.messages import CONTACTS, GATEWAY, IMAGE, LABEL, Contact, Contacts, GatewayStatus, Image, Label
from skin.layout import Layout
from skin.taxel_places import Forces, Grid
from skin.wall_times import CLOCKS, Clocks, WallTimes
from viewer.checks import contacts_fit, image_fits, label_fits, status_fits
from viewer.state import ViewState

#: What a `Painter` takes.
TOPICS: Final = (CLOCKS, IMAGE, CONTACTS, LABEL, GATEWAY)
#: Notices are looked for so often.
NOTICES_S: Final = 1.0
NS: Final = 1_000_000_000


class Canvas(Protocol):
    """A view, or a file for one. Times are sampling instants on the wall clock."""

    def image(self, time_ns: int, cycle: int, measured_n: Forces) -> None:
        """Draw the force on every taxel, shape (rows, columns), newtons; NaN where not measured."""
        ...

    def contacts(self, time_ns: int, cycle: int, contacts: Sequence[Contact]) -> None:
        """Draw the contacts of an image in the place of those before."""
        ...

    def figure(self, time_ns: int, name: str, value: float) -> None:
        """Add a value to a curve."""
        ...

    def line(self, time_ns: int, level: str, text: str) -> None:
        """Add a line to the log; the level is info, warning or error."""
        ...

    def close(self) -> None:
        """Give all to the view."""
        ...


class Painter:
    """Draws what comes.

    Parameters
    ----------
    layout : Layout
    canvas : Canvas
    wall : WallTimes, optional
        The clocks of the messages.

    Attributes
    ----------
    drawn : int
        Number of images so far.
    refused : int
        Messages that do not fit the layout.
    """

    def __init__(self, layout: Layout, canvas: Canvas, wall: WallTimes | None = None) -> None:
        self.drawn = self.refused = 0
        self._layout, self._canvas, self._grid = layout, canvas, Grid(layout)
        self._wall, self._state = wall or WallTimes(), ViewState(layout)
        self._label = ""
        self._notices: dict[str, str] = {}
        self._due_s = float("-inf")

    def take(self, message: msgspec.Struct, now_s: float, time_ns: int) -> None:
        """Draw a message of a topic of `TOPICS`; the clocks say when it came, and `time_ns` is of the wall."""
        match message:
            case Clocks():
                self._wall.take(message)
            case Image() if image_fits(message, self._layout):
                self._state.take_image(message, now_s)
                self._image(message)
            case Contacts() if contacts_fit(message, self._layout):
                self._state.take_contacts(message, now_s)
                if not message.blind:  # no contacts would mean: no contact
                    at_ns = self._wall.time_ns(message.sampled_mono_ns)
                    self._canvas.contacts(at_ns, message.cycle, message.contacts)
            case Label() if label_fits(message):
                self._state.take_label(message, now_s)
                self._name(message)
            case GatewayStatus() if status_fits(message):
                self._state.take_gateway(message, now_s)
                for bus in message.buses:
                    self._canvas.figure(time_ns, f"load/{bus.name}", bus.load_ratio)
            case _:
                self.refused += 1
        self.look(now_s, time_ns)

    def look(self, now_s: float, time_ns: int) -> None:
        """Write notices that begin or end to the log, once in `NOTICES_S`."""
        if now_s < self._due_s:
            return
        self._due_s = now_s + NOTICES_S
        found = {notice.text: notice.level for notice in self._state.snapshot(now_s)[0].notices}
        for text in found.keys() - self._notices.keys():
            self._canvas.line(time_ns, found[text], text)
        for text in self._notices.keys() - found.keys():
            self._canvas.line(time_ns, "info", f"over: {text}")
        self._notices = found

    def _image(self, image: Image) -> None:
        time_ns, valid = self._wall.time_ns(image.sampled_mono_ns), self._grid.valid(image)
        self.drawn += 1
        self._canvas.image(time_ns, image.cycle, self._grid.measured_n(image))
        self._canvas.figure(time_ns, "valid_share", float(valid.mean()))
        self._canvas.figure(time_ns, "force_n", float(self._grid.forces_n(image)[valid].sum()))

    def _name(self, label: Label) -> None:
        time_ns = self._wall.time_ns(label.sampled_mono_ns)
        measured = is_measured(label, self._layout.measurement.sums)
        self._canvas.figure(time_ns, "label_confidence", label.confidence if measured and label.label else 0.0)
        if measured and label.label != self._label:
            self._label = label.label
            self._canvas.line(time_ns, "info", f"touched by: {label.label}" if label.label else "untouched")
