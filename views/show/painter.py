"""From messages of the fabric to a canvas: images, contacts, curves and log lines."""

from collections.abc import Sequence
from typing import Final, Protocol

import msgspec

from canskin.messages import CONTACTS, GATEWAY, IMAGE, LABEL, Contact, Contacts, GatewayStatus, Image, Label
from canskin.peers import Peer
from health.snapshot import Notice
from health.state import FRESH_S, ViewState
from skin.layout import Layout
from skin.taxel_places import Forces, Grid
from skin.wall_times import CLOCKS, Clocks, WallTimes

#: Name of the service on the fabric.
SERVICE: Final = "show"
#: What a `Painter` takes.
TOPICS: Final = (CLOCKS, IMAGE, CONTACTS, LABEL, GATEWAY)
#: Period of the search for notices.
NOTICES_S: Final = 1.0
#: After this time without an image contacts are no longer drawn.
_FRESH_NS: Final = round(FRESH_S * 1e9)


class Canvas(Protocol):
    """A view, or a file for one. Times are sampling instants on the wall clock."""

    def image(self, time_ns: int, cycle: int, measured_n: Forces) -> None:
        """Draw the force on every taxel, shape (rows, columns), newtons; NaN where not measured."""
        ...

    def contacts(self, time_ns: int, cycle: int | None, contacts: Sequence[Contact]) -> None:
        """Draw the contacts of an image in the place of those before; without cycle they are of no image."""
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
    """Draws what comes; images and contacts whose time on the wall clock is not known are not drawn.

    Parameters
    ----------
    wall : WallTimes, optional
        The clocks of the messages.

    Attributes
    ----------
    drawn : int
        Number of images so far.
    """

    def __init__(self, layout: Layout, canvas: Canvas, wall: WallTimes | None = None) -> None:
        self.drawn = 0
        self._layout, self._canvas, self._grid = layout, canvas, Grid(layout)
        self._wall, self._state = wall or WallTimes(), ViewState(layout, service=SERVICE)
        self._sending_ratio = float(layout.phi().has_sums.mean())
        self._label = ""
        self._notices: dict[tuple[str, str], Notice] = {}
        self._due_s = float("-inf")
        #: When contacts that are drawn came, and their sampling instant.
        self._contacts_at: tuple[float, int] | None = None

    def take(self, message: msgspec.Struct, now_s: float, time_ns: int) -> None:
        """Draw a message of a topic of `TOPICS`; the clocks say when it came, and `time_ns` is of the wall."""
        if not isinstance(message, Clocks) and not self._state.take(message, now_s):
            return
        match message:
            case Clocks():
                self._wall.take(message)
            case Image():
                self._image(message)
            case Contacts():
                self._contacts(message, now_s)
            case Label():
                self._name(message)
            case GatewayStatus():
                for bus in message.buses:
                    self._canvas.figure(time_ns, f"load/{bus.name}", bus.load_ratio)

    def take_peer(self, peer: Peer, is_alive: bool, now_s: float) -> None:
        """Note that a peer came or went at `now_s`."""
        self._state.take_peer(peer, is_alive, now_s)

    def look(self, now_s: float, time_ns: int, undecodable: int = 0) -> None:
        """Clear contacts of stale images; write notices that begin or end to the log, once in `NOTICES_S`.

        `undecodable` messages count as ignored.
        """
        if self._contacts_at is not None and now_s - self._contacts_at[0] > FRESH_S:
            self._canvas.contacts(self._contacts_at[1] + _FRESH_NS, None, [])
            self._contacts_at = None
        if now_s < self._due_s:
            return
        self._due_s = now_s + NOTICES_S
        notices = self._state.snapshot(now_s, undecodable)[0].notices
        found = {(each.code, each.subject): each for each in notices}
        for key in found.keys() - self._notices.keys():
            self._canvas.line(time_ns, found[key].level, f"{found[key].text} [{found[key].code}]")
        for key in self._notices.keys() - found.keys():
            self._canvas.line(time_ns, "info", f"over: {self._notices[key].text} [{self._notices[key].code}]")
        self._notices = found

    def _contacts(self, contacts: Contacts, now_s: float) -> None:
        """Draw the contacts; none while the skin is blind, as none is known then."""
        time_ns = self._wall.time_ns(contacts.sampled_mono_ns)
        if time_ns is None:
            return
        found = [] if contacts.blind else contacts.contacts
        self._canvas.contacts(time_ns, contacts.cycle, found)
        self._contacts_at = (now_s, time_ns) if found else None

    def _image(self, image: Image) -> None:
        time_ns, valid = self._wall.time_ns(image.sampled_mono_ns), self._grid.valid(image)
        if time_ns is None:
            return
        self.drawn += 1
        self._canvas.image(time_ns, image.cycle, self._grid.measured_n(image))
        self._canvas.figure(time_ns, "valid_share", float(valid.mean() / self._sending_ratio))
        self._canvas.figure(time_ns, "force_n", float(self._grid.forces_n(image)[valid].sum()))

    def _name(self, label: Label) -> None:
        time_ns = self._wall.time_ns(label.sampled_mono_ns)
        if time_ns is None:
            return
        measured = label.is_measured(self._layout.measurement.sums)
        self._canvas.figure(time_ns, "label_confidence", label.confidence if measured and label.label else 0.0)
        if measured and label.label != self._label:
            self._label = label.label
            self._canvas.line(time_ns, "info", f"touched by: {label.label}" if label.label else "untouched")
