"""The state of a skin: messages in, snapshots out. Time is an argument; there is no thread and no connection here."""

from collections import deque
from typing import Final, Generic, NamedTuple, TypeVar

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
    TRUTH,
    Contacts,
    GatewayStatus,
    Image,
    Label,
    Mark,
    NodesStatus,
    Truth,
)
from canskin.peers import Peer, new_peer
from health.checks import fits
from health.nodes_why import NodeTroubles
from health.notices import display_name, notices
from health.patches import Patches
from health.snapshot import (
    ContactsState,
    Figures,
    GatewayState,
    ImageState,
    LabelState,
    NodesState,
    PatchState,
    Pictures,
    Pixels,
    Service,
    Snapshot,
    TruthState,
    aged,
    gateway_state,
)
from health.window import Rate, Window
from skin.ground_truth import ImagePairs, image_pairs, in_contact
from skin.layout import Layout
from skin.psnr import adds_noise, psnr_db

#: What a `ViewState` takes.
TOPICS: Final = (IMAGE, CONTACTS, TRUTH, LABEL, MARK, GATEWAY, NODES)
#: Images, contacts, labels and truths older than this are stale.
FRESH_S: Final = 0.5
#: Counters older than this are stale; the gateway and the nodes publish theirs five times a second.
STATUS_FRESH_S: Final = 1.5
#: Most processes of nodes shown; the one with the oldest message is dropped first.
PROCESSES: Final = 64
#: Most services kept; the service that has been gone for longest is dropped first.
SERVICES: Final = 64
#: Most tokens kept, tokens of other skins included.
PEERS: Final = 256
LATENCY_SPAN_S: Final = 5.0
SPAN_S: Final = 1.0

Message = TypeVar("Message")


class Last(NamedTuple, Generic[Message]):
    """A message and the time when it came."""

    message: Message
    at_s: float


class Excess(NamedTuple):
    """A force above the threshold of a region: since when, when last, and the largest force, newtons."""

    since_s: float
    last_s: float
    peak_n: float


class Moment(NamedTuple):
    """A skin at one instant, for curves: None for what was not measured then.

    Attributes
    ----------
    force_n : float or None
        On the whole skin.
    latency_s : float or None
        Of the newest image, from SYNC to its publication.
    load_ratio : float or None
        The largest of the buses.
    missing : int or None
        Frames with sums that did not come, since the start of the gateway.
    label : str or None
        Empty without contact.
    mark : str or None
        What touches the skin, as the newest mark says; empty where that says nothing.
    contacts : list of (int, float), or None
        Identity and force in newtons of each contact.
    """

    force_n: float | None
    latency_s: float | None
    load_ratio: float | None
    missing: int | None
    label: str | None
    mark: str | None
    contacts: list[tuple[int, float]] | None


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
        self._layout, phi = layout, layout.phi()
        self._sending_blocks = int(phi.has_sums.sum())
        self._epoch_s = epoch_s
        self._service_name = service
        self._image: Last[Image] | None = None
        self._contacts: Last[Contacts] | None = None
        self._truth: Last[Truth] | None = None
        self._label: Last[Label] | None = None
        self._mark: Mark | None = None
        self._gateway: Last[GatewayStatus] | None = None
        self._nodes: dict[str, Last[NodesStatus]] = {}
        self._services: dict[str, Service] = {}
        self._self = new_peer(layout.name, display_name(service), phi.fingerprint)
        self._peers: dict[str, Peer] = {}
        self._pairing: ImagePairs = image_pairs(layout)
        self._latency_s = Window(LATENCY_SPAN_S)
        self._valid, self._rate = Window(SPAN_S), Rate(SPAN_S)
        self._patches, self._troubles = Patches(layout), NodeTroubles()
        self._over: dict[str, Excess] = {}
        #: Image, truth, and when their pair was found; a pair is compared when a snapshot needs its PSNR.
        self._pairs: deque[tuple[Image, Truth, float]] = deque()
        self._psnr_image_db, self._psnr_sensor_db = Window(SPAN_S), Window(SPAN_S)

    def take(self, message: msgspec.Struct, now_s: float) -> bool:
        """Use a message of one of `TOPICS` that came at `now_s`; return whether it fits the skin."""
        if not fits(message, self._layout):
            self.ignored += 1
            return False
        match message:
            case Image():
                self._take_image(message, now_s)
            case Contacts():
                self._contacts = Last(message, now_s)
            case Truth():
                self._truth = Last(message, now_s)
                self._keep(self._pairing.take_truth(message), now_s)
            case Label():
                self._label = Last(message, now_s)
            case Mark():
                self._mark = message
            case GatewayStatus():
                self._gateway = Last(message, now_s)
                self._troubles.take(message, now_s)
            case NodesStatus():
                self._nodes.pop(message.process, None)
                self._nodes[message.process] = Last(message, now_s)
                while len(self._nodes) > PROCESSES:
                    del self._nodes[next(iter(self._nodes))]
        return True

    def _take_image(self, image: Image, now_s: float) -> None:
        # An image without any new sum, of a skin with nothing to send, has no latency.
        is_new = self._image is None or self._image.message.sampled_mono_ns != image.sampled_mono_ns
        self._image = Last(image, now_s)
        self._valid.add(now_s, self._valid_blocks(image))
        if image.valid_sums and not self._layout.sends.in_cycles:  # a quiet skin has images without new sums
            self._rate.add(now_s, image.published_mono_ns * 1e-9)
        elif image.valid_sums and is_new:
            self._rate.add(now_s, image.sampled_mono_ns * 1e-9)
        if image.valid_sums and is_new:
            self._latency_s.add(now_s, (image.published_mono_ns - image.sampled_mono_ns) * 1e-9)
        for name, force_n in self._patches.over(image):
            before = self._over.get(name)
            if before is None or now_s - before.last_s > SPAN_S:
                before = Excess(now_s, now_s, force_n)
            self._over[name] = Excess(before.since_s, now_s, max(before.peak_n, force_n))
        self._keep(self._pairing.take(image), now_s)

    def _keep(self, pairs: list[tuple[Image, Truth]], now_s: float) -> None:
        self._pairs += [(*pair, now_s) for pair in pairs]
        while self._pairs and self._pairs[0][2] <= now_s - SPAN_S:
            self._pairs.popleft()

    def take_service(self, name: str, alive: bool, now_s: float) -> None:
        """Note that a service came or went at `now_s`."""
        known = self._services.get(name)
        if known is not None and known.alive == alive:
            return
        if known is None and len(self._services) >= SERVICES:
            gone = [each for each, service in self._services.items() if not service.alive]
            if not gone:
                return
            del self._services[min(gone, key=lambda each: self._services[each].since_time_s)]
        self._services[name] = Service(alive=alive, since_time_s=self._epoch_s + now_s)

    def take_peer(self, peer: Peer, alive: bool, now_s: float) -> None:
        """Note that a peer came or went at `now_s`; a service is gone when its last peer of this name is gone."""
        if not alive:
            self._peers.pop(peer.key, None)
        elif len(self._peers) < PEERS:
            self._peers[peer.key] = peer
        if peer.skin == self._layout.name:
            there = any(each.skin == peer.skin and each.service == peer.service for each in self._peers.values())
            self.take_service(peer.service, there, now_s)
            if peer.service == RECORDER and not there:
                self._mark = None  # nobody keeps it

    def running(self, service: str) -> set[str]:
        """Return the services of this name that the skin has, each as `canskin.peers.Peer.instance`."""
        name = self._layout.name, service
        return {each.instance for each in self._peers.values() if (each.skin, each.service) == name}

    def snapshot(self, now_s: float, undecodable: int = 0, *, is_single: bool = False) -> tuple[Snapshot, Pictures]:
        """Return snapshot and pictures at `now_s`; `undecodable` messages count as ignored.

        The PSNR of a single snapshot is that of its image, not the mean of the last second, which costs more.
        """
        while self._pairs and not is_single:
            compared, true, at_s = self._pairs.popleft()
            if errors_db := self._compare(compared, true):
                self._psnr_image_db.add(at_s, errors_db[0])
                self._psnr_sensor_db.add(at_s, errors_db[1])
        truth, gateway = self._truth_shown(now_s), self._gateway_state(now_s)
        bare = Snapshot(
            time_s=self._epoch_s + now_s,
            skin=self._layout.name,
            image=self._image_state(now_s),
            contacts=self._contacts_state(now_s),
            truth=truth[0] if truth else None,
            patches=self._patches_state(now_s),
            label=self._label_state(now_s),
            figures=self._figures(now_s, truth[1] if truth and is_single else None),
            gateway=gateway,
            nodes=self._nodes_states(now_s),
            services={name: self._service(name, gateway, now_s) for name in sorted(self._services)},
            other_skins=sorted({peer.skin for peer in self._peers.values() if peer.fingerprint} - {self._layout.name}),
            cut_off=self._is_cut_off(now_s),
            ignored=self.ignored + undecodable,
            notices=[],
        )
        pictures = Pictures(
            image=self._grid(self._image.message.pixels) if self._image else None,
            true=self._grid(truth[1].true) if truth else None,
            sensor=self._grid(truth[1].sensor) if truth else None,
        )
        is_grid = self._layout.taxels.surface.is_grid
        return notices(bare, self._service_name, is_grid=is_grid), pictures

    def _compare(self, image: Image, truth: Truth) -> tuple[float, float] | None:
        """Return the PSNR of an image and of the sensor's; None without contact."""
        peak_n = self._layout.taxels.force_max_n
        true = self._grid(truth.true)
        if not in_contact(true, peak_n):
            return None
        there = self._layout.taxels.without_gaps
        image_db, sensor_db = (
            psnr_db(there(true), there(self._grid(each)), peak_n) for each in (image.pixels, truth.sensor)
        )
        return image_db, sensor_db

    def _image_state(self, now_s: float) -> ImageState | None:
        if self._image is None:
            return None
        image, at_s = self._image
        invalid = np.flatnonzero(np.frombuffer(image.valid, np.uint8) == 0)
        return ImageState(
            cycle=image.cycle,
            sampled_error_ns=image.sampled_error_ns,
            age_s=now_s - at_s,
            stale=self._is_stale("reconstructor", at_s, now_s, FRESH_S),
            invalid_blocks=[int(block) for block in invalid],
            valid_sums=image.valid_sums,
            solve_s=image.solve_s,
        )

    def _contacts_state(self, now_s: float) -> ContactsState | None:
        if self._contacts is None:
            return None
        contacts, at_s = self._contacts
        return aged(ContactsState, contacts, now_s - at_s, stale=self._is_stale("reconstructor", at_s, now_s, FRESH_S))

    def _truth_shown(self, now_s: float) -> tuple[TruthState, Truth] | None:
        """Return the truth of the cycle of the image shown; None if it has not come, or was too long ago."""
        shown = None if self._image is None else self._pairing.truth_of(self._image.message)
        if self._image is None or shown is None:
            return None
        age_s = now_s - self._image.at_s
        return TruthState(step=shown.step, label=shown.label, age_s=age_s, stale=age_s > FRESH_S), shown

    def _patches_state(self, now_s: float) -> list[PatchState]:
        if self._image is None:
            return []
        over = {name: each for name, each in self._over.items() if now_s - each.last_s <= SPAN_S}
        return [
            msgspec.structs.replace(
                patch,
                is_over=True,
                over_since_time_s=self._epoch_s + over[patch.name].since_s,
                peak_n=over[patch.name].peak_n,
            )
            if patch.name in over
            else patch
            for patch in self._patches.of(self._image.message)
        ]

    def moment(self, now_s: float) -> Moment:
        """Return what curves show of `now_s`."""
        image, contacts, gateway, label = self._image, self._contacts, self._gateway, self._label
        if image is None or self._is_stale("reconstructor", image.at_s, now_s, FRESH_S) or not image.message.valid_sums:
            image = None
        if contacts is None or self._is_stale("reconstructor", contacts.at_s, now_s, FRESH_S) or contacts.message.blind:
            contacts = None
        if gateway is None or self._is_stale("gateway", gateway.at_s, now_s, STATUS_FRESH_S):
            gateway = None
        if label is None or self._is_stale("classifier", label.at_s, now_s, FRESH_S):
            label = None
        is_labelled = label is not None and label.message.is_measured(self._layout.measurement.sums)
        return Moment(
            force_n=image and self._patches.total_n(image.message),
            latency_s=image and (image.message.published_mono_ns - image.message.sampled_mono_ns) * 1e-9,
            load_ratio=gateway and max((bus.load_ratio for bus in gateway.message.buses), default=None),
            missing=gateway and gateway.message.frames.missing,
            label=label.message.label if label is not None and is_labelled else None,
            mark=None if self._mark is None else self._mark.label,
            contacts=contacts and [(each.identity, each.force_n) for each in contacts.message.contacts],
        )

    def _label_state(self, now_s: float) -> LabelState | None:
        if self._label is None:
            return None
        label, at_s = self._label
        measured = label.is_measured(self._layout.measurement.sums)
        stale = self._is_stale("classifier", at_s, now_s, FRESH_S)
        return aged(LabelState, label, now_s - at_s, stale=stale, measured=measured)

    def _figures(self, now_s: float, single: Truth | None) -> Figures:
        latency_s = self._latency_s.values(now_s)
        low = self._valid.values(now_s)
        image_db, sensor_db = self._psnr_image_db.mean(now_s), self._psnr_sensor_db.mean(now_s)
        if single is not None and self._image is not None:
            image_db, sensor_db = self._compare(self._image.message, single) or (None, None)
        return Figures(
            images_hz=self._rate.per_s(now_s),
            latency_p50_s=float(np.percentile(latency_s, 50)) if latency_s else None,
            latency_p99_s=float(np.percentile(latency_s, 99)) if latency_s else None,
            psnr_image_db=image_db,
            psnr_sensor_db=sensor_db,
            sensor_adds_noise=None if sensor_db is None else adds_noise(sensor_db, self._layout.taxels.adc_bits),
            valid_blocks=self._valid_blocks(self._image.message) if self._image else None,
            valid_blocks_low=int(min(low)) if low else None,
            blocks=self._sending_blocks,
        )

    def _service(self, name: str, gateway: GatewayState | None, now_s: float) -> Service:
        """Return the state of a service; of several with one name, a service that differs from this page's skin."""
        own = [each for each in self._peers.values() if (each.skin, each.service) == (self._layout.name, name)]
        if not own:
            return self._services[name]
        peer = next((each for each in own if self._self.difference(each)), own[-1])
        return msgspec.structs.replace(
            self._services[name],
            silent=self._is_silent(name, gateway, now_s),
            version=peer.version,
            fingerprint=peer.fingerprint,
            scheduling=peer.scheduling,
            difference=self._self.difference(peer),
        )

    def _is_silent(self, name: str, gateway: GatewayState | None, now_s: float) -> bool:
        """Tell whether a running service has input but sends nothing."""
        if gateway is None or name == "gateway":
            return gateway is not None and gateway.stale
        last = {"reconstructor": self._image, "classifier": self._label}.get(name)
        has_input = not gateway.stale and 0 < STATUS_FRESH_S * gateway.sync_rate_hz < gateway.cycles
        is_new = now_s + self._epoch_s - self._services[name].since_time_s < STATUS_FRESH_S
        if name not in {"reconstructor", "classifier"} or not has_input or is_new:
            return False
        return last is None or now_s - last.at_s > FRESH_S

    def _gateway_state(self, now_s: float) -> GatewayState | None:
        if self._gateway is None:
            return None
        status, at_s = self._gateway
        troubles = self._troubles.of(self._epoch_s)
        return gateway_state(
            status, troubles, now_s - at_s, stale=self._is_stale("gateway", at_s, now_s, STATUS_FRESH_S)
        )

    def _nodes_states(self, now_s: float) -> list[NodesState]:
        found = (self._nodes[name] for name in sorted(self._nodes))
        return [aged(NodesState, status, now_s - at_s, stale=now_s - at_s > STATUS_FRESH_S) for status, at_s in found]

    def _is_cut_off(self, now_s: float) -> bool:
        """Tell whether the hub is out of reach: this service's own token is gone, and no message comes."""
        own = self._services.get(self._service_name)
        if own is None or own.alive:
            return False
        newest = (self._image, self._truth, self._label, self._gateway)
        gone_s = own.since_time_s - self._epoch_s
        return not any(last and last.at_s > gone_s and now_s - last.at_s <= FRESH_S for last in newest)

    def _is_stale(self, service: str, at_s: float, now_s: float, fresh_s: float) -> bool:
        """Tell whether a message of `service` from `at_s` is too old, or the service has gone since."""
        token = self._services.get(service)
        gone = token is not None and not token.alive and token.since_time_s >= self._epoch_s + at_s
        return gone or now_s - at_s > fresh_s

    def _grid(self, pixels: bytes) -> Pixels:
        return np.frombuffer(pixels, "<f4").reshape(self._layout.taxels.rows, self._layout.taxels.columns)

    @staticmethod
    def _valid_blocks(image: Image) -> int:
        return int(np.count_nonzero(np.frombuffer(image.valid, np.uint8)))
