"""Which skin a verb is for: its layout comes from ``--layout``, from the recording that is read, or from the hub."""

import math
import time
from collections.abc import Callable
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

import msgspec
from cyclopts import Parameter

from canskin.description import DESCRIPTION, LAYOUT, LayoutReply, LayoutRequest
from canskin.errors import BusError, DeniedError, InputError, LayoutError, Stopped, tell
from canskin.fabric import Fabric
from canskin.keys import accepts, environment_keys
from canskin.peers import GATEWAYS, Peer
from canskin.roles import Action, refusal
from canskin.session import (
    DEFAULT_ENDPOINT,
    LOOK_S,
    Stop,
    Words,
    checked,
    find_skin,
    is_loopback,
    is_open,
    peers_at,
)
from canskin.skin_clock import TIME, time_reply
from recording import is_recording
from skin.description import describe
from skin.difference import difference
from skin.layout import Layout, layout_text, load_layout, parse_layout
from skin.limits import check_bytes

#: Longest wait for the hub, the skin and its layout: that of `canskin.connect`.
PATIENCE_S: Final = 5.0
#: The same of a service: a gateway that is started with it needs up to 22 s beside a busy skin.
SERVICE_PATIENCE_S: Final = 30.0
#: Longest wait for a hub that is there already.
GLANCE_S: Final = 0.5
#: The option of a hub that may serve a network without keys.
Insecure = Annotated[bool, Parameter(negative=())]
_WORDS: Final = Words("--connect", "--skin NAME", "start 'skin gateway', or give --layout FILE")


@Parameter(name="*")
@dataclass(frozen=True)
class SkinOptions:
    """Which skin.

    Attributes
    ----------
    layout
        TOML of the skin, a recording (.mcap) of the skin, or the name of a layout that comes with canskin; default: the
        layout that the hub tells. A service with ``--layout`` waits for its hub.
    connect
        Endpoint of the fabric's hub, usually the gateway; default: a socket that only this user may open.
    skin
        Name of the skin, where the hub has several, see ``skin list``; ``skin reconstruct`` and ``skin classify`` take
        all of them.
    """

    layout: Path | None = None
    connect: str | None = None
    skin: str | None = None

    @property
    def endpoint(self) -> str:
        """The hub's endpoint."""
        return self.connect or DEFAULT_ENDPOINT

    def find(
        self, service: str = "skin", stop: Stop | None = None, recording: Path | None = None, *, needs_hub: bool = True
    ) -> Layout:
        """Return the layout.

        Parameters
        ----------
        service : str
            Name in the log, where the hub is waited for.
        stop : Stop, optional
            Of a service, which has more patience; if set meanwhile, `canskin.errors.Stopped` is raised.
        recording : pathlib.Path, optional
            What the verb reads; a recording has its layout in itself.
        needs_hub : bool
            False for a verb that works without services: without an option and a recording the layout is that of a hub
            that is there now, else the default one.

        Raises
        ------
        BusError
            If the hub is asked, and no hub or no such skin comes in `PATIENCE_S`, with `stop` in `SERVICE_PATIENCE_S`;
            or if several skins are there.
        """
        given = self.layout
        if given is None and is_recording(recording):
            given = recording
        if given is None and (needs_hub or self.connect or self.skin or (not recording and told_skins(self.endpoint))):
            return hub_layout(self.endpoint, self.skin, stop, patience_s=PATIENCE_S, service=service)
        layout = load_layout(given)
        if self.skin not in {None, layout.name}:
            raise InputError(f"--skin {self.skin}: {given} is of skin '{layout.name}': leave one of both out")
        return layout

    def find_all(self, service: str, stop: Stop) -> list[Layout]:
        """Return the layouts of all skins on the hub, by name; with an option that names a skin that of the skin.

        Raises as `find`.
        """
        if self.layout is not None or self.skin is not None:
            return [self.find(service, stop)]
        words = _WORDS._replace(service=service)
        found = find_skin(self.endpoint, None, SERVICE_PATIENCE_S, knows_layout, words=words, stop=stop, is_one=False)
        return [
            hub_layout(self.endpoint, name, stop, service=service) for name in sorted({each.skin for each in found})
        ]

    def require_right(self, action: Action, name: str) -> None:
        """Raise DeniedError if the role of the keys may not do an action, before a skin is looked for."""
        keys = checked(self.endpoint, environment_keys())[1]
        if keys is not None and (why := refusal(keys.role, action, name)):
            raise DeniedError(f"keys {keys.folder}: {why}")

    def join(
        self,
        layout: Layout,
        service: str,
        stop: Stop | None = None,
        patience_s: float = math.inf,
        prepare: Callable[[Fabric], None] = lambda _: None,
    ) -> Fabric:
        """Return the connection of a service to the hub; see `Fabric`.

        Raises
        ------
        LayoutError
            If ``--layout`` differs from the layout on the hub.
        """
        fabric = join(layout, service, self.endpoint, stop=stop, patience_s=patience_s, prepare=prepare)
        try:
            if self.layout is not None:
                self.compare(layout, fabric.instance, stop)
        except BaseException:
            fabric.close()
            raise
        return fabric

    def compare(self, layout: Layout, instance: str = "", stop: Stop | None = None) -> None:
        """Raise as `join` if a hub is there now, and another service than `instance` tells a layout.

        Where other skins alone are there, the services of this skin may come later: they are waited for, then a line
        names the others.
        """
        try:  # a connection of its own: that of a service knows the others only after a while
            fabric = Fabric(layout.name, "", self.endpoint, stop=stop, patience_s=GLANCE_S)
        except BusError:
            return
        with closing(fabric):
            self._compare(layout, fabric, instance, stop)

    def _compare(self, layout: Layout, fabric: Fabric, instance: str, stop: Stop | None) -> None:
        give_up_s = time.monotonic() + PATIENCE_S
        while others := [each for each in fabric.peers() if each.fingerprint and each.instance != instance]:
            if own := [each for each in others if each.skin == layout.name]:
                with suppress(BusError):  # no gateway is there, or it is of an older version
                    told = _told(fabric, own[0], self.endpoint)
                    if differs := difference(msgspec.to_builtins(layout), msgspec.to_builtins(told)):
                        raise LayoutError(
                            f"{self.layout} is not the layout of skin '{layout.name}' at {self.endpoint}:"
                            f" {differs}. Leave --layout out, or start the other"
                            " services with it"
                        )
                return
            if stop is not None and stop.is_set():
                raise Stopped
            if time.monotonic() > give_up_s:
                found = ", ".join(sorted({f"'{each.skin}'" for each in others}))
                tell("skin", f"no service of '{layout.name}' ({self.layout}) is at {self.endpoint} yet, found {found}")
                return
            time.sleep(LOOK_S)


def check_listen(endpoint: str, *, insecure: bool) -> None:
    """Raise InputError if a hub at `endpoint` serves a network without keys, and that is not asked for."""
    if is_open(endpoint) and not insecure:
        raise InputError(
            f"--listen {endpoint}: everybody on that network could read the skin, tare it and send false images:"
            " expected tls/… and --keys FOLDER, an address of loopback, or --insecure"
        )


def check_host(given: str, host: str, may: str, *, insecure: bool) -> None:
    """Raise InputError if `host`, from what was `given`, is of a network, and that is not asked for.

    `may` is what everybody there could do.
    """
    if not insecure and not is_loopback(host):
        raise InputError(
            f"{given}: everybody on that network could {may}: expected an address of loopback, or --insecure"
        )


def join(
    layout: Layout,
    service: str,
    endpoint: str,
    *,
    hub: bool = False,
    stop: Stop | None = None,
    patience_s: float = math.inf,
    prepare: Callable[[Fabric], None] = lambda _: None,
) -> Fabric:
    """Return the connection of a service that knows its layout; a gateway tells it whoever asks. See `Fabric`."""

    def describe_it(fabric: Fabric) -> None:  # before the others see the service: then they ask
        if service in GATEWAYS:
            about, told = describe(layout), LayoutReply(layout_text(layout))
            check_bytes(len(told.toml), LayoutError, f"the text of layout '{layout.name}'")
            fabric.answer(LAYOUT, lambda _request, reply: reply(told))
            fabric.answer(DESCRIPTION, lambda _request, reply: reply(about))
            fabric.answer(TIME, lambda _request, reply: reply(time_reply()))
        prepare(fabric)

    return Fabric(
        layout.name,
        service,
        endpoint,
        hub=hub,
        stop=stop,
        fingerprint=layout.operator().fingerprint,
        patience_s=patience_s,
        prepare=describe_it,
    )


def await_skins(endpoint: str, service: str, stop: Stop) -> None:
    """Wait for the hub, and for a skin there; raise BusError if none comes in `SERVICE_PATIENCE_S`."""
    words = _WORDS._replace(service=service)
    find_skin(endpoint, None, SERVICE_PATIENCE_S, knows_layout, words=words, stop=stop, is_one=False)


def hub_layout(
    endpoint: str,
    skin: str | None,
    stop: Stop | None = None,
    *,
    patience_s: float = PATIENCE_S,
    service: str = "skin",
) -> Layout:
    """Return the layout of a skin on a hub; see `SkinOptions.find`. Each step waits for `patience_s` at most."""
    find_s = patience_s if stop is None else SERVICE_PATIENCE_S
    peer = find_skin(endpoint, skin, find_s, knows_layout, words=_WORDS._replace(service=service), stop=stop)[0]
    with closing(Fabric(peer.skin, "", endpoint, stop=stop, patience_s=patience_s)) as fabric:
        return _told(fabric, peer, endpoint, patience_s)


def told_skins(endpoint: str) -> list[str]:
    """Return the names of the skins whose layout is told at an endpoint now; none, and no wait, without a hub."""
    try:
        endpoint, keys = checked(endpoint, environment_keys())
        if not accepts(endpoint):
            return []
        peers = peers_at(endpoint, GLANCE_S, lambda found: any(map(knows_layout, found)), keys=keys)
    except BusError:
        return []
    return sorted({peer.skin for peer in peers if knows_layout(peer)})


def knows_layout(peer: Peer) -> bool:
    """Tell whether a service tells the layout of its skin."""
    return peer.service in GATEWAYS and bool(peer.fingerprint)


def _told(fabric: Fabric, peer: Peer, endpoint: str, patience_s: float = PATIENCE_S) -> Layout:
    try:
        reply: LayoutReply = fabric.ask(LAYOUT, LayoutRequest(), patience_s)
    except DeniedError:
        raise
    except BusError as error:
        raise BusError(
            f"{peer.service} of skin '{peer.skin}', canskin {peer.version}, tells no layout at {endpoint}: give"
            " --layout FILE"
        ) from error
    return parse_layout(reply.toml.encode(), f"the layout of {peer.service} at {endpoint}", is_whole=True)
