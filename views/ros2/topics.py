"""The topics of ROS 2 that a skin has, and what goes out on them when a message of the fabric comes."""

from collections.abc import Callable, Iterator, Mapping
from functools import cache, partial
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np

from canskin.messages import CONTACTS, GATEWAY, LABEL, Contacts, Image, Label
from canskin.messages import IMAGE as SKIN_IMAGE
from health.state import ViewState
from skin.layout import Layout
from skin.regions import regions_of
from skin.taxel_places import Grid
from skin.wall_times import CLOCKS, Clocks, WallTimes
from views.ros2 import content
from views.ros2.diagnostics import diagnostics, key
from views.ros2.names import RELIABLE, SENSOR_DATA, Qos
from views.ros2.types import DIAGNOSTICS, IMAGE, MARKERS, POINT_CLOUD, TEXT, WRENCH


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
#: Of the whole skin.
SKIN_WRENCH: Final = RosTopic("wrench", WRENCH)
#: Cycle of each image and label, with the sampling instant as stamp: images and texts have no place for them.
KEY: Final = RosTopic("key", DIAGNOSTICS)
DIAGNOSTIC_ARRAY: Final = RosTopic("/diagnostics", DIAGNOSTICS, RELIABLE)
ROS_TOPICS: Final = (
    *(FORCE_IMAGE, HEAT_MAP, TAXEL_CLOUD, SKIN_WRENCH),
    *(CONTACT_CLOUD, CONTACT_MARKERS, LABEL_TEXT, KEY, DIAGNOSTIC_ARRAY),
)


def topics_of(layout: Layout) -> tuple[RosTopic, ...]:
    """Return the topics of a skin: `ROS_TOPICS`, and a wrench of each region but the whole skin."""
    return (*ROS_TOPICS, *(RosTopic(f"wrench/{each.name}", WRENCH) for each in regions_of(layout)[1:]))


#: What a `Translator` takes.
SKIN_TOPICS: Final = (CLOCKS, SKIN_IMAGE, CONTACTS, LABEL, GATEWAY)

#: A topic and how its message is made: it costs nothing where nobody listens.
Draft = tuple[RosTopic, Callable[[], Any]]


class Translator:
    """Turns messages of a skin's fabric into messages of ROS 2.

    Parameters
    ----------
    frame : str
        Frame of the messages: `skin.surface` says where it lies.
    state : ViewState
        What the diagnostics tell of; takes every message, too.
    wall : WallTimes, optional
        The clocks of the messages; default: images and contacts before the first measurement have no time, and nothing
        goes out because of them.
    """

    def __init__(
        self,
        layout: Layout,
        frame: str,
        state: ViewState,
        *,
        wall: WallTimes | None = None,
    ) -> None:
        self._layout, self._frame, self._state = layout, frame, state
        self._grid, self._wall = Grid(layout), wall or WallTimes()
        phi, is_used = layout.phi(), ~layout.taxels.is_masked
        wrenches = (SKIN_WRENCH, *topics_of(layout)[len(ROS_TOPICS) :])
        #: Topic, taxels and blocks of each region.
        self._regions = [
            (topic, taxels := each.taxels & is_used & phi.is_wired, np.unique(phi.block_of_taxel[taxels]))
            for topic, each in zip(wrenches, regions_of(layout), strict=True)
        ]
        self._drafts: Mapping[type, Callable[[Any], Iterator[Draft]]] = {
            Image: self._image,
            Contacts: self._contacts,
            Label: self._label,
        }

    def take(self, message: msgspec.Struct, now_s: float) -> Iterator[Draft]:
        """Use a message of a topic of `SKIN_TOPICS` that came at `now_s`; return what goes out because of it."""
        if isinstance(message, Clocks):
            self._wall.take(message)
            return iter(())
        make = self._drafts.get(type(message))
        return make(message) if self._state.take(message, now_s) and make else iter(())

    def diagnostics(self, now_s: float, time_ns: int, undecodable: int = 0) -> Any:
        """Return the state of the skin at `now_s`; `undecodable` messages count as ignored."""
        return diagnostics(content.header(time_ns, self._frame), self._state.snapshot(now_s, undecodable)[0])

    def _header(self, sampled_mono_ns: int) -> Any | None:
        """Return a header with a sampling instant; None if its time on the wall clock is not known."""
        time_ns = self._wall.time_ns(sampled_mono_ns)
        return None if time_ns is None else content.header(time_ns, self._frame)

    def _image(self, image: Image) -> Iterator[Draft]:
        taxels, grid, head = self._layout.taxels, self._grid, self._header(image.sampled_mono_ns)
        if head is None:
            return
        measured_n = cache(partial(grid.measured_n, image))
        if taxels.surface.is_grid:
            yield FORCE_IMAGE, lambda: content.force_image(head, measured_n())
            yield HEAT_MAP, lambda: content.heat_map(head, measured_n(), taxels.force_max_n)
        yield TAXEL_CLOUD, lambda: content.taxel_cloud(head, taxels.surface, grid.forces_n(image), grid.valid(image))
        valid = np.frombuffer(image.valid, np.bool_)
        for topic, region, blocks in self._regions:
            if blocks.size and valid[blocks].all():  # a part of a force would be taken for the whole
                yield topic, partial(content.wrench, head, taxels.surface, grid.forces_n(image), region)
        yield KEY, lambda: key(head, self._layout.name, "image", {"cycle": image.cycle})

    def _contacts(self, contacts: Contacts) -> Iterator[Draft]:
        taxels, found, sampled_ns = self._layout.taxels, contacts.contacts, contacts.sampled_mono_ns
        head = self._header(sampled_ns)
        if contacts.blind or head is None:  # an empty message would mean: no contact
            return
        yield CONTACT_CLOUD, lambda: content.contact_cloud(head, taxels.surface, found, sampled_ns)
        yield CONTACT_MARKERS, lambda: content.contact_markers(head, taxels, found)

    def _label(self, label: Label) -> Iterator[Draft]:
        if label.is_measured(self._layout.measurement.sums):
            yield LABEL_TEXT, lambda: content.text(label.label)
            if (head := self._header(label.sampled_mono_ns)) is not None:
                values = {"cycle": label.cycle, "label": label.label, "confidence": label.confidence}
                yield KEY, lambda: key(head, self._layout.name, "label", values)
