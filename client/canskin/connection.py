"""Connection to a running skin."""

import threading
import time
from pathlib import Path
from typing import Final

import msgspec
import zenoh

from canskin.calibration_messages import ANSWER_S, CALIBRATION, CalibrationReply, Region, tare_request
from canskin.description import DESCRIPTION, Description, DescriptionRequest
from canskin.errors import BusError, InputError, RunError, SkinError
from canskin.fabric import Fabric
from canskin.frame import Frame, FrameBuilder
from canskin.keys import Keys
from canskin.messages import CONTACTS, GATEWAY, IMAGE, LABEL, MARK, MEASUREMENT, GatewayStatus, Mark
from canskin.peers import GATEWAYS, Peer, client_version
from canskin.session import DEFAULT_ENDPOINT, close_with_program, find_skin, peers_at
from canskin.skin import CLOSED, FrameHub, Frames, Health, Skin

#: Name of this service on the fabric.
NAME: Final = "client"
#: Time between two requests for the description of a skin whose layout has changed.
ASK_AGAIN_S: Final = 1.0
#: Name of a recorder on the fabric.
RECORDER: Final = "recorder"


def connect(
    endpoint: str = DEFAULT_ENDPOINT,
    skin: str | None = None,
    *,
    timeout_s: float = 5.0,
    keys: str | Path | None = None,
) -> Skin:
    """Connect to a running skin.

    Parameters
    ----------
    endpoint : str
        Address of the skin's hub, as ``skin demo`` prints it; default: that of this user's ``skin gateway``.
    skin : str, optional
        Name of the skin; needed where a hub has several.
    timeout_s : float
        Longest wait for the hub and the skin, and later for a frame.
    keys : str or pathlib.Path, optional
        Folder of keys, which ``skin keys`` makes; default: ``$SKIN_KEYS``. A hub with keys has an address such as
        ``tls/192.168.1.20:7447``.

    Raises
    ------
    InputError
        If the timeout is no number above 0, or the keys cannot be used.
    BusError
        If the hub refuses the keys, or there is no such hub or skin in time; the message says what was looked for and
        what was found.

    Examples
    --------
    >>> with canskin.connect() as skin:
    ...     for frame in skin:
    ...         print(frame.label, [contact.force_n for contact in frame.contacts])
    """
    if not isinstance(timeout_s, int | float) or not timeout_s > 0:
        raise InputError(f"timeout_s: expected seconds above 0, got {timeout_s!r}")
    give_up_s = time.monotonic() + timeout_s
    held = None if keys is None else Keys(keys)
    name = find_skin(endpoint, skin, timeout_s, _knows, keys=held)[0].skin
    fabric = Fabric(name, NAME, endpoint, patience_s=max(1.0, give_up_s - time.monotonic()), keys=held)
    try:
        layout: Description = fabric.ask(DESCRIPTION, DescriptionRequest(), max(1.0, give_up_s - time.monotonic()))
        return ConnectedSkin(fabric, layout, endpoint, timeout_s)
    except BaseException:
        fabric.close()
        raise


def skins_at(endpoint: str = DEFAULT_ENDPOINT, *, timeout_s: float = 1.0, keys: str | Path | None = None) -> list[str]:
    """Return the names of the skins on a hub, in the order of the alphabet.

    Parameters
    ----------
    endpoint : str
        Address of the hub; see `connect`.
    timeout_s : float
        How long to wait for the first skin.
    keys : str or pathlib.Path, optional
        See `connect`.

    Raises
    ------
    InputError
        If the keys cannot be used.
    BusError
        If the hub refuses the keys, or there is no such hub in time.
    """
    held = None if keys is None else Keys(keys)
    return _skins_of(peers_at(endpoint, timeout_s, lambda peers: bool(_skins_of(peers)), keys=held))


def _skins_of(peers: list[Peer]) -> list[str]:
    return sorted({peer.skin for peer in peers if _knows(peer)})


def _knows(peer: Peer) -> bool:
    return peer.service in GATEWAYS


class ConnectedSkin(Skin):
    """A skin on a fabric; see `connect`."""

    def __init__(self, fabric: Fabric, layout: Description, endpoint: str, timeout_s: float) -> None:
        super().__init__(layout, timeout_s)
        self._fabric = fabric
        self._endpoint = endpoint
        self._peers: dict[str, Peer] = {}
        self._asks_at_s = 0.0
        self._status: GatewayStatus | None = None
        self._clock = fabric.clock(layout.boot_id)
        self._builder = FrameBuilder(layout, self._clock)
        self._lock = threading.Lock()
        self._came = threading.Condition()
        self._hub = FrameHub(timeout_s, self._silence)
        fabric.watch_peers(self._note)
        fabric.subscribe(GATEWAY, self._take_status)
        for topic in (MEASUREMENT, LABEL, IMAGE, CONTACTS):
            fabric.subscribe(topic, self._take)
        close_with_program(self.close)

    def frames(self, queue: int = 1) -> Frames:
        """See `Skin.frames`."""
        return self._hub.frames(queue)

    def latest(self, max_age_s: float = 1.0) -> Frame:
        """See `Skin.latest`."""
        return self._hub.latest(max_age_s)

    def tare(self, *, force: bool = False, region: Region | str | None = None) -> str:
        """See `Skin.tare`."""
        if self._hub.is_closed:
            raise BusError(CLOSED)
        request = tare_request(self.layout.rows, self.layout.columns, force=force, region=region)
        reply: CalibrationReply = self._fabric.ask(CALIBRATION, request, ANSWER_S)
        if not reply.is_done:
            raise RunError(reply.text)
        return reply.text

    def mark(self, label: str) -> None:
        """See `Skin.mark`."""
        super().mark(label)
        if self._hub.is_closed:
            raise BusError(CLOSED)
        self._fabric.require_right("put", MARK.name)
        with self._came:
            if not self._came.wait_for(lambda: RECORDER in self._services(), self._timeout_s):
                raise BusError(
                    f"no recorder of skin '{self.layout.name}' is at {self._endpoint}: start 'skin record run.mcap', or"
                    " the mark is lost"
                )
        self._fabric.publish(MARK, Mark(label=label))

    @property
    def health(self) -> Health:
        """See `Skin.health`."""
        return Health(
            services=frozenset(self._services()),
            gateway=self._status,
            frames=self._hub.count,
            refused=self._builder.refused + self._fabric.malformed,
            missed=self._fabric.missed.counts(),
        )

    def close(self) -> None:
        """See `Skin.close`."""
        if self._hub.is_closed:
            return
        self._hub.close()
        self._fabric.close()

    def _take(self, message: msgspec.Struct) -> None:
        with self._lock:  # each topic has a thread
            for frame in self._builder.take(message):
                self._hub.put(frame)
            asks = self._builder.is_outdated and time.monotonic() >= self._asks_at_s
            if asks:
                self._asks_at_s = time.monotonic() + ASK_AGAIN_S
        if asks:
            threading.Thread(target=self._describe, daemon=True).start()

    def _describe(self) -> None:
        """Ask for the description anew: the gateway was started again with another layout."""
        try:
            layout: Description = self._fabric.ask(DESCRIPTION, DescriptionRequest(), ASK_AGAIN_S)
        except (SkinError, zenoh.ZError):  # asked again with the next measurement, until the skin is closed
            return
        with self._lock:
            if layout.fingerprint != self.layout.fingerprint:
                self.layout = layout
                self._builder, refused = FrameBuilder(layout, self._clock), self._builder.refused
                self._builder.refused = refused

    def _note(self, peer: Peer, is_alive: bool) -> None:
        if peer.skin != self.layout.name:
            return
        with self._came:
            if is_alive:
                self._peers[peer.key] = peer
            else:
                self._peers.pop(peer.key, None)
            self._came.notify_all()

    def _services(self) -> list[str]:
        return sorted({peer.service for peer in self._peers.copy().values()} - {NAME})

    def _take_status(self, status: GatewayStatus) -> None:
        self._status = status

    def _silence(self) -> str:
        """Say why no frame came."""
        alive, own = self._services(), client_version()
        others = sorted({peer.version for peer in self._peers.copy().values() if peer.version} - {own})
        missing = [verb for service, verb in _MAKERS if service not in alive]
        if "skin gateway" in missing and "replay" in alive:
            missing.clear()
        advice = "is its bus silent? See skin.health"
        if missing:
            advice = f"start '{missing[0]}'"
        elif others:
            advice = f"services are canskin {', '.join(others)}, this client is {own}: install one version"
        found = f"found {', '.join(alive)}" if alive else "found no service"
        return (
            f"no image of skin '{self.layout.name}' came from {self._endpoint} in {self._timeout_s:g} s, {found}:"
            f" {advice}"
        )


#: Services that an image needs, and how they are started.
_MAKERS: Final = (("gateway", "skin gateway"), ("reconstructor", "skin reconstruct"))
