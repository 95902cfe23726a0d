"""The topics of ROS 2 that a skin has, and what goes out on them when a message of the fabric comes."""

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final, NamedTuple

import msgspec

from canskin.messages import CONTACTS, GATEWAY, LABEL, MEASUREMENT, Contacts, Image, Label, Topic
from canskin.messages import IMAGE as SKIN_IMAGE
from ros2 import content
from ros2.diagnostics import diagnostics
from ros2.names import RELIABLE, SENSOR_DATA, Qos
from ros2.types import DIAGNOSTICS, IMAGE, MARKERS, POINT_CLOUD, TEXT
from skin.clock import wall_offset
from skin.labels import is_measured
from skin.layout import Layout
from skin.taxel_places import Grid
from viewer.checks import contacts_fit, image_fits, label_fits
from viewer.state import ViewState

#: Measurements whose clocks are kept: an image is at most some cycles older than the newest measurement.
_CLOCKS: Final = 64


class RosTopic(NamedTuple):
    """A topic: its name below the namespace, or a full name, type, and quality of service."""

    name: str
    ros_type: str
    qos: Qos = SENSOR_DATA


FORCE_IMAGE: Final = RosTopic("image", IMAGE)
HEAT_MAP: Final = RosTopic("heat_map", IMAGE)
TAXEL_CLOUD: Final = RosTopic("points", POINT_CLOUD)
CONTACT_CLOUD: Final = RosTopic("contacts", POINT_CLOUD)
CONTACT_MARKERS: Final = RosTopic("contact_markers", MARKERS)
LABEL_TEXT: Final = RosTopic("label", TEXT)
DIAGNOSTIC_ARRAY: Final = RosTopic("/diagnostics", DIAGNOSTICS, RELIABLE)
ROS_TOPICS: Final = (
    *(FORCE_IMAGE, HEAT_MAP, TAXEL_CLOUD),
    *(CONTACT_CLOUD, CONTACT_MARKERS, LABEL_TEXT, DIAGNOSTIC_ARRAY),
)


class Clocks(msgspec.Struct, frozen=True):
    """The clocks of a `canskin.messages.Measurement`, without its sums."""

    sampled_mono_ns: int
    wall_offset_ns: int = 0


#: The clocks of every measurement.
CLOCKS: Final = Topic(MEASUREMENT.name, Clocks)
#: What a `Translator` takes.
SKIN_TOPICS: Final = (CLOCKS, SKIN_IMAGE, CONTACTS, LABEL, GATEWAY)

#: A topic and how its message is made: it costs nothing where nobody listens.
Draft = tuple[RosTopic, Callable[[], Any]]


class Translator:
    """Turns messages of a skin's fabric into messages of ROS 2.

    Parameters
    ----------
    layout : Layout
    frame : str
        Frame of the messages: `skin.taxel_places` says where it lies.
    state : ViewState
        What the diagnostics tell of; takes every message, too.
    wall_offset_ns : callable
        Wall clock minus the clock of the messages, for those before the first measurement; default: of this machine.

    Attributes
    ----------
    refused : int
        Messages that do not fit the layout.
    """

    def __init__(
        self,
        layout: Layout,
        frame: str,
        state: ViewState,
        *,
        wall_offset_ns: Callable[[], int] = lambda: wall_offset().ns,
    ) -> None:
        self.refused = 0
        self._layout, self._frame, self._state = layout, frame, state
        self._grid, self._wall_offset_ns = Grid(layout), wall_offset_ns
        self._offsets: deque[Clocks] = deque(maxlen=_CLOCKS)
        self._drafts: Mapping[type, Callable[[Any], Iterator[Draft]]] = {
            Image: self._image,
            Contacts: self._contacts,
            Label: self._label,
        }
        self._takes: Mapping[type, Callable[[Any, float], None]] = {
            Image: state.take_image,
            Contacts: state.take_contacts,
            Label: state.take_label,
            GATEWAY.message: state.take_gateway,
        }

    def take(self, message: msgspec.Struct, now_s: float) -> Iterator[Draft]:
        """Use a message of a topic of `SKIN_TOPICS` that came at `now_s`; return what goes out because of it."""
        if isinstance(message, Clocks):
            if message.wall_offset_ns:
                self._offsets.append(message)
            return iter(())
        self._takes[type(message)](message, now_s)
        make = self._drafts.get(type(message))
        return make(message) if make else iter(())

    def diagnostics(self, now_s: float, time_ns: int) -> Any:
        """Return the state of the skin at `now_s`."""
        return diagnostics(content.header(time_ns, self._frame), self._state.snapshot(now_s)[0])

    def time_ns(self, sampled_mono_ns: int) -> int:
        """Return a sampling instant on the wall clock, by the newest measurement that is not later.

        Without any measurement that tells its clocks, by `wall_offset_ns`.
        """
        if not self._offsets:
            return sampled_mono_ns + self._wall_offset_ns()
        before = (each for each in reversed(self._offsets) if each.sampled_mono_ns <= sampled_mono_ns)
        return sampled_mono_ns + next(before, self._offsets[0]).wall_offset_ns

    def _header(self, sampled_mono_ns: int) -> Any:
        return content.header(self.time_ns(sampled_mono_ns), self._frame)

    def _image(self, image: Image) -> Iterator[Draft]:
        if not image_fits(image, self._layout):
            self.refused += 1
            return
        taxels, grid, head = self._layout.taxels, self._grid, self._header(image.sampled_mono_ns)
        measured_n = grid.measured_n(image)
        yield FORCE_IMAGE, lambda: content.force_image(head, measured_n)
        yield HEAT_MAP, lambda: content.heat_map(head, measured_n, taxels.force_max_n)
        yield TAXEL_CLOUD, lambda: content.taxel_cloud(head, taxels, grid.forces_n(image), grid.valid(image))

    def _contacts(self, contacts: Contacts) -> Iterator[Draft]:
        if contacts.blind:  # an empty message would mean: no contact
            return
        if not contacts_fit(contacts, self._layout):
            self.refused += 1
            return
        taxels, found, sampled_ns = self._layout.taxels, contacts.contacts, contacts.sampled_mono_ns
        head = self._header(sampled_ns)
        yield CONTACT_CLOUD, lambda: content.contact_cloud(head, taxels, found, sampled_ns)
        yield CONTACT_MARKERS, lambda: content.contact_markers(head, taxels, found)

    def _label(self, label: Label) -> Iterator[Draft]:
        if label_fits(label) and is_measured(label, self._layout.measurement.sums):
            yield LABEL_TEXT, lambda: content.text(label.label)
