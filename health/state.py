"""The state of a skin: messages in, snapshots out. Time is an argument; there is no thread and no connection here."""

from collections import deque
from collections.abc import Callable
from math import inf
from typing import Any, Final, Generic, TypeVar

import msgspec
import numpy as np

from canskin.connection import RECORDER
from canskin.messages import (
    CONTACTS,
    GATEWAY,
    IMAGE,
    LABEL,
    MARK,
    NODES,
    SERVICES,
    TRUTH,
    Contacts,
    GatewayStatus,
    Image,
    Label,
    Mark,
    NodesStatus,
    ServiceStatus,
    Truth,
)
from canskin.peers import Peer, new_peer
from health.checks import fits
from health.comparison import Comparison
from health.nodes_why import Troubles
from health.notices import display_name, notices
from health.patches import Patches
from health.services import Services
from health.snapshot import (
    BusView,
    ContactsState,
    Figures,
    GatewayState,
    ImageState,
    LabelState,
    Moment,
    NodesState,
    Pictures,
    Pixels,
    Service,
    Snapshot,
    TruthState,
    bus_views,
)
from health.window import Rate, Window
from skin.layout import Layout
from skin.psnr import adds_noise

#: What a `ViewState` takes.
TOPICS: Final = (IMAGE, CONTACTS, TRUTH, LABEL, MARK, GATEWAY, NODES, SERVICES)
#: Images, contacts, labels and truths older than this are stale.
FRESH_S: Final = 0.5
#: An image is shown without its contacts, its label or its truth if they have not come this long after it.
HELD_S: Final = 0.1
#: Most images, contacts and labels that wait for what belongs to them.
WAITING: Final = 512
#: Counters older than this are stale; the gateway and the nodes publish theirs five times a second.
STATUS_FRESH_S: Final = 1.5
#: Messages that do not fit are told until none has come for this time.
MISFITS_S: Final = 3.0
#: Most processes of nodes shown; the one with the oldest message is dropped first.
PROCESSES: Final = 64
LATENCY_SPAN_S: Final = 5.0
SPAN_S: Final = 1.0

Message = TypeVar("Message", bound=msgspec.Struct)
Aged = TypeVar("Aged")


class Latest(Generic[Message]):
    """The newest message of a topic.

    Parameters
    ----------
    services : Services
        A message is stale when its sender has gone.
    sender : str
        Name of the service that sends it.
    fresh_s : float
        The message is stale after this time.

    Attributes
    ----------
    message : struct or None
        What is shown; None before the first.
    at_s : float
        When the newest came.
    """

    def __init__(self, services: Services, sender: str, fresh_s: float = FRESH_S) -> None:
        self.message: Message | None = None
        self.at_s = -inf
        self._services, self._sender, self._fresh_s = services, sender, fresh_s

    def take(self, message: Message, now_s: float) -> None:
        """Take a message that came at `now_s`."""
        self.message, self.at_s = message, now_s

    def is_stale(self, now_s: float) -> bool:
        """Tell whether the message is too old, or its sender has gone since."""
        gone_s = self._services.since_s(self._sender, alive=False)
        return now_s - self.at_s > self._fresh_s or (gone_s is not None and gone_s >= self.at_s)

    def fresh(self, now_s: float) -> Message | None:
        """Return the message, None if it is stale."""
        return None if self.is_stale(now_s) else self.message

    def shown(self, kind: type[Aged], now_s: float, **more: Any) -> Aged | None:
        """Return the message as snapshots have it: of a `kind` with its fields, its age, and `more`."""
        if self.message is None:
            return None
        age = {"age_s": now_s - self.at_s, "stale": self.is_stale(now_s)}
        return kind(**{**msgspec.structs.asdict(self.message), **age, **more})


class Held(Latest[Message]):
    """Messages of a topic, of which that of the instant shown is chosen; `Latest` describes the parameters."""

    def __init__(self, services: Services, sender: str) -> None:
        super().__init__(services, sender)
        #: Messages, from the one shown on, and when they came.
        self.came: deque[tuple[Message, float]] = deque(maxlen=WAITING)

    def take(self, message: Message, now_s: float) -> None:
        """Keep a message that came at `now_s`."""
        self.came.append((message, now_s))
        self.at_s = now_s

    def choose(self, is_fit: Callable[[Message, float], bool]) -> None:
        """Show the newest message that is fit, given when it came, or none; forget those before it."""
        chosen = next((each for each in reversed(self.came) if is_fit(*each)), None)
        self.message = chosen[0] if chosen else None
        while chosen and self.came[0] is not chosen:
            self.came.popleft()


class ViewState:
    """State of one skin, as the page, ROS 2, Rerun and Foxglove show it.

    Parameters
    ----------
    layout : Layout
        Of the skin shown; messages that do not fit it are counted in `ignored` and not shown.
    epoch_s : float
        Wall-clock time of ``now_s = 0``; notices give wall-clock times.
    service : str
        Name of the service that shows the skin: without its own token the hub is out of reach.
    """

    def __init__(self, layout: Layout, epoch_s: float = 0.0, service: str = "viewer") -> None:
        self.ignored = 0
        self._ignored = 0, -inf
        self._layout, phi = layout, layout.phi()
        self._sending_blocks = int(phi.has_sums.sum())
        self._epoch_s, self._service_name = epoch_s, service
        self._services = Services(new_peer(layout.name, display_name(service), phi.fingerprint), epoch_s)
        self._image = Held[Image](self._services, "reconstructor")
        self._contacts = Held[Contacts](self._services, "reconstructor")
        self._label = Held[Label](self._services, "classifier")
        self._gateway = Latest[GatewayStatus](self._services, "gateway", STATUS_FRESH_S)
        self._latest: dict[type, Latest[Any]] = {
            Image: self._image,
            Contacts: self._contacts,
            Label: self._label,
            GatewayStatus: self._gateway,
        }
        self._buses: list[BusView] = []
        self._mark: Mark | None = None
        self._nodes: dict[str, Latest[NodesStatus]] = {}
        #: When the newest message came.
        self._came_s = -inf
        self._latency_s = Window(LATENCY_SPAN_S)
        self._valid, self._rate = Window(SPAN_S), Rate(SPAN_S)
        self._patches, self._troubles = Patches(layout), Troubles()
        self._comparison, self._has_truths = Comparison(layout, SPAN_S), False

    def take(self, message: msgspec.Struct, now_s: float) -> bool:
        """Use a message of one of `TOPICS` that came at `now_s`; return whether it fits the skin."""
        if not fits(message, self._layout):
            self.ignored += 1
            return False
        if isinstance(message, ServiceStatus):  # a service hears itself, also without the hub
            self._services.take_status(message, now_s)
            return True
        self._came_s = now_s
        match message:
            case Image():
                self._count(message, now_s)
                self._patches.take(message, now_s)
                self._comparison.take(message, now_s)
            case Truth():
                self._comparison.take(message, now_s)
                self._has_truths = True
            case Mark():
                self._mark = message
            case GatewayStatus():
                self._troubles.take(message, now_s)
                self._buses = bus_views(message, self._troubles.of(self._epoch_s))
            case NodesStatus():
                self._nodes.pop(message.process, None)
                self._nodes[message.process] = process = Latest[NodesStatus](self._services, "", STATUS_FRESH_S)
                process.take(message, now_s)
                while len(self._nodes) > PROCESSES:
                    del self._nodes[next(iter(self._nodes))]
        if (latest := self._latest.get(type(message))) is not None:
            latest.take(message, now_s)
        return True

    def _count(self, image: Image, now_s: float) -> None:
        """Count an image before it is taken."""
        # An image without any new sum, of a skin with nothing to send, has no latency.
        before = self._image.came[-1][0] if self._image.came else None
        is_new = before is None or before.sampled_mono_ns != image.sampled_mono_ns
        self._valid.add(now_s, _valid_blocks(image))
        if image.valid_sums and not self._layout.sends.in_cycles:  # a quiet skin has images without new sums
            self._rate.add(now_s, image.published_mono_ns * 1e-9)
        elif image.valid_sums and is_new:
            self._rate.add(now_s, image.sampled_mono_ns * 1e-9)
        if image.valid_sums and is_new:
            self._latency_s.add(now_s, _latency_s(image))

    def take_peer(self, peer: Peer, alive: bool, now_s: float) -> None:
        """Note that a peer came or went at `now_s`; a service is gone when its last peer of this name is gone."""
        self._services.take(peer, alive, now_s)
        if peer.service == RECORDER and not self.running(RECORDER):
            self._mark = None  # nobody keeps it

    def running(self, service: str) -> set[str]:
        """Return the services of this name that the skin has, each as `canskin.peers.Peer.instance`."""
        return {each.instance for each in self._services.peers(service)}

    def snapshot(self, now_s: float, undecodable: int = 0, *, is_single: bool = False) -> tuple[Snapshot, Pictures]:
        """Return snapshot and pictures at `now_s`; `undecodable` messages count as ignored.

        The PSNR of a single snapshot is that of its image, not the mean of the last second, which costs more.
        """
        self._choose(now_s)
        if (ignored := self.ignored + undecodable) > self._ignored[0]:
            self._ignored = ignored, now_s
        image, status = self._image.message, self._gateway.message
        truth = None if image is None else self._comparison.truth_of(image)
        if not is_single:
            psnr_db = self._comparison.means_db(now_s)
        elif image is not None and truth is not None:
            psnr_db = self._comparison.single_db(image, truth)
        else:
            psnr_db = None, None
        calibration = status.calibration if status else None
        late, late_since_time_s = self._troubles.late(self._epoch_s)
        bare = Snapshot(
            time_s=self._epoch_s + now_s,
            skin=self._layout.name,
            moment=self.moment(now_s),
            image=self._image_state(now_s),
            contacts=self._contacts.shown(ContactsState, now_s),
            truth=self._truth_state(truth, now_s),
            patches=[] if image is None else self._patches.of(image, now_s, self._epoch_s),
            label=self._label.shown(LabelState, now_s, measured=self._is_labelled),
            figures=self._figures(now_s, *psnr_db),
            gateway=self._gateway.shown(
                GatewayState,
                now_s,
                buses=self._buses,
                zero=calibration.zero_words if calibration else "",
                late=late,
                late_since_time_s=late_since_time_s,
            ),
            nodes=[shown for _, each in sorted(self._nodes.items()) if (shown := each.shown(NodesState, now_s))],
            services=self._service_states(now_s),
            other_skins=self._services.other_skins(),
            cut_off=self._is_cut_off(now_s),
            ignored=ignored if now_s - self._ignored[1] < MISFITS_S else 0,
            notices=[],
        )
        pictures = Pictures(
            image=self._grid(image.pixels) if image else None,
            true=self._grid(truth.true) if truth else None,
            sensor=self._grid(truth.sensor) if truth else None,
        )
        is_grid = self._layout.taxels.surface.is_grid
        return notices(bare, self._service_name, is_grid=is_grid), pictures

    def _choose(self, now_s: float) -> None:
        """Choose the newest image that all that belongs to it has come to, and its contacts and its label.

        The label is the newest that is not newer than the image: the classifier may leave cycles out. While no images
        come, contacts and labels are the newest.
        """
        # An image that is older than this is shown no longer, whatever the next one still waits for.
        held_s = HELD_S if self._image.came and now_s - self._image.came[0][1] <= FRESH_S else 0.0
        self._image.choose(
            lambda image, at_s: image is self._image.message or now_s - at_s >= held_s or self._is_whole(image)
        )
        image = None if self._image.is_stale(now_s) else self._image.message
        self._contacts.choose(
            lambda each, _: not image or (each.cycle, each.sampled_mono_ns) == (image.cycle, image.sampled_mono_ns)
        )
        self._label.choose(lambda each, _: not image or each.sampled_mono_ns <= image.sampled_mono_ns)

    def _is_whole(self, image: Image) -> bool:
        """Tell whether contacts, label and truth of an image have come, if any such messages come."""
        others: tuple[Held[Any], ...] = self._contacts, self._label
        is_reached = all(not each.came or each.came[-1][0].sampled_mono_ns >= image.sampled_mono_ns for each in others)
        return is_reached and (not self._has_truths or self._comparison.truth_of(image) is not None)

    def _image_state(self, now_s: float) -> ImageState | None:
        image = self._image.message
        if image is None:
            return None
        invalid = np.flatnonzero(np.frombuffer(image.valid, np.uint8) == 0)
        return ImageState(
            cycle=image.cycle,
            sampled_error_ns=image.sampled_error_ns,
            age_s=now_s - self._image.at_s,
            stale=self._image.is_stale(now_s),
            invalid_blocks=[int(block) for block in invalid],
            valid_sums=image.valid_sums,
            solve_s=image.solve_s,
        )

    def _truth_state(self, truth: Truth | None, now_s: float) -> TruthState | None:
        """Return the truth of the image shown, which is as old as the image."""
        age_s = now_s - self._image.at_s
        return None if truth is None else TruthState(truth.step, truth.label, age_s, age_s > FRESH_S)

    @property
    def _is_labelled(self) -> bool:
        label = self._label.message
        return label is not None and label.is_measured(self._layout.measurement.sums)

    def moment(self, now_s: float) -> Moment:
        """Return what curves show of `now_s`."""
        self._choose(now_s)
        image, contacts = self._image.fresh(now_s), self._contacts.fresh(now_s)
        gateway, label = self._gateway.fresh(now_s), self._label.fresh(now_s)
        image = image if image and image.valid_sums else None
        contacts = None if contacts and contacts.blind else contacts
        return Moment(
            force_n=self._patches.total_n(image) if image else None,
            latency_s=_latency_s(image) if image else None,
            load_ratio=max((bus.load_ratio for bus in gateway.buses), default=None) if gateway else None,
            missing=gateway.frames.missing if gateway else None,
            label=label.label if label and self._is_labelled else None,
            mark=self._mark.label if self._mark else None,
            contacts=[(each.identity, each.force_n) for each in contacts.contacts] if contacts else None,
        )

    def _figures(self, now_s: float, image_db: float | None, sensor_db: float | None) -> Figures:
        latency_s, low, image = self._latency_s.values(now_s), self._valid.values(now_s), self._image.message
        usual_s, most_s = np.percentile(latency_s, (50, 99)).tolist() if latency_s else (None, None)
        return Figures(
            images_hz=self._rate.per_s(now_s),
            latency_p50_s=usual_s,
            latency_p99_s=most_s,
            psnr_image_db=image_db,
            psnr_sensor_db=sensor_db,
            sensor_adds_noise=None if sensor_db is None else adds_noise(sensor_db, self._layout.taxels.adc_bits),
            valid_blocks=_valid_blocks(image) if image else None,
            valid_blocks_low=int(min(low)) if low else None,
            blocks=self._sending_blocks,
        )

    def _service_states(self, now_s: float) -> dict[str, Service]:
        """Return the services; those are silent that have input but send nothing."""
        status, is_stale = self._gateway.message, self._gateway.is_stale(now_s)
        has_input = status and not is_stale and 0 < STATUS_FRESH_S * status.sync_rate_hz < status.cycles
        at_s = {"classifier": self._label.at_s, "reconstructor": self._image.at_s}
        found = self._services.states(now_s)
        for name, service in found.items():
            since_s = self._services.since_s(name, alive=True)
            if since_s is None:
                continue
            is_silent = name == "gateway" and status is not None and is_stale
            if name in at_s and has_input and now_s - since_s >= STATUS_FRESH_S:
                is_silent = now_s - at_s[name] > FRESH_S
            found[name] = msgspec.structs.replace(service, silent=is_silent)
        return found

    def _is_cut_off(self, now_s: float) -> bool:
        """Tell whether the hub is out of reach: this service's own token is gone, and no message comes."""
        gone_s = self._services.since_s(self._service_name, alive=False)
        return gone_s is not None and (self._came_s <= gone_s or now_s - self._came_s > FRESH_S)

    def _grid(self, pixels: bytes) -> Pixels:
        return np.frombuffer(pixels, "<f4").reshape(self._layout.taxels.rows, self._layout.taxels.columns)


def _valid_blocks(image: Image) -> int:
    return int(np.count_nonzero(np.frombuffer(image.valid, np.uint8)))


def _latency_s(image: Image) -> float:
    return (image.published_mono_ns - image.sampled_mono_ns) * 1e-9
