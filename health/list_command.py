"""``skin list``: the skins on a hub, their services, and what they send."""

import time
from collections import Counter
from contextlib import ExitStack, closing, suppress
from functools import partial
from typing import Any, Final

import msgspec

from canskin.errors import BusError, DeniedError
from canskin.fabric import Fabric
from canskin.messages import IMAGE, LABEL, MEASUREMENT, TRUTH, NmtState, Topic
from canskin.peers import GATEWAYS, Peer
from canskin.session import DEFAULT_ENDPOINT, peers_at
from health.causes import Cause
from health.feed import Watched
from health.snapshot import Snapshot
from shell.skin_options import PATIENCE_S, hub_layout, knows_layout
from shell.terminal import Json, print_json, print_table
from skin.layout import Layout
from skin.ranges import require_above_zero

#: What the services send, from which their rates are counted.
SENT: Final[dict[str, Topic]] = {
    "gateway": MEASUREMENT,
    "replay": MEASUREMENT,
    "reconstructor": IMAGE,
    "classifier": LABEL,
    "nodes": TRUTH,
}
SECONDS_MAX: Final = 60.0


class Listed(msgspec.Struct, frozen=True, kw_only=True):
    """A service on a hub.

    Attributes
    ----------
    rate_hz : float or None
        None if it publishes nothing, or these keys may not hear its messages.
    causes : list of str
        Codes of what is wrong with it (`health.causes.Cause`); of a gateway, with the rest of its skin, too.
    """

    skin: str
    service: str
    state: str
    causes: list[str]
    rate_hz: float | None
    version: str
    scheduling: str
    fingerprint: str


def list_(*, connect: str = DEFAULT_ENDPOINT, seconds: float = 2.0, json: Json = False) -> None:
    """List the skins on a hub and their services: state, what is wrong, messages in a second, layout.

    ``skin doctor`` explains what is wrong.

    Parameters
    ----------
    connect
        Endpoint of the fabric's hub.
    seconds
        Time in which messages are counted.
    json
        Print one JSON object.

    Examples
    --------
    skin list
    skin list --connect tcp/10.0.0.5:7447 --json
    """
    require_above_zero("--seconds", seconds, SECONDS_MAX)
    peers = peers_at(connect, PATIENCE_S, bool, "--connect", service="list")
    peers.sort(key=lambda peer: (peer.skin, peer.service))
    if not peers:
        raise BusError(f"no service at {connect}: start 'skin gateway', or give another --connect")
    layouts = {name: _layout(name, peers, connect) for name in sorted({peer.skin for peer in peers})}
    counts, looks = _heard(layouts, connect, seconds)
    services = [_listed(peer, peers, counts, looks.get(peer.skin), seconds) for peer in peers]
    if json:
        about = {name: {"layout": _words(each)} if isinstance(each, Layout) else each for name, each in layouts.items()}
        notices = {name: look.notices for name, look in looks.items()}
        print_json({"skins": about, "services": services, "notices": notices})
        return
    for name, each in layouts.items():
        print(f"{name}: {_words(each) if isinstance(each, Layout) else each['error']}")
    rows = ((each or "-" for each in map(_cell, msgspec.structs.astuple(service))) for service in services)
    print_table(["skin", "service", "state", "causes", "messages/s", "version", "scheduling", "Φ"], rows)


def _cell(value: Any) -> str:
    if isinstance(value, list):
        return ", ".join(value)
    return "" if value is None else f"{value:.1f}" if isinstance(value, float) else str(value)


def _heard(
    layouts: dict[str, Layout | dict[str, str]], endpoint: str, seconds: float
) -> tuple[Counter[tuple[str, str]], dict[str, Snapshot]]:
    """Return how many messages of each skin and topic came in a time, and how the skins are whose layout is known.

    Topics that the role of the keys may not hear are missing, as are those of other skins.
    """
    counts: Counter[tuple[str, str]] = Counter()
    looks: dict[str, Watched] = {}

    def count(key: tuple[str, str], *_: object) -> None:
        counts[key] += 1

    with ExitStack() as stack:
        for skin, layout in layouts.items():
            # Without a name: the other services do not see this program come and go.
            fabric = stack.enter_context(closing(Fabric(skin, "", endpoint, patience_s=PATIENCE_S)))
            for topic in {each.name: each for each in SENT.values()}.values():
                with suppress(DeniedError):
                    fabric.subscribe_bytes(topic, partial(count, (skin, topic.name)))
                    counts.setdefault((skin, topic.name), 0)
            if isinstance(layout, Layout):
                with suppress(DeniedError):
                    looks[skin] = Watched(layout, fabric)
        time.sleep(seconds)
        return counts, {skin: look.look() for skin, look in looks.items()}


def _listed(
    peer: Peer, peers: list[Peer], counts: Counter[tuple[str, str]], look: Snapshot | None, seconds: float
) -> Listed:
    topic = SENT.get(peer.service)
    told = None if topic is None else counts.get((peer.skin, topic.name))
    rate_hz = None if told is None else told / seconds
    state = "runs" if rate_hz is None else "sends" if rate_hz else "silent"
    if peer.service == "gateway" and look is not None and look.gateway is not None:
        nmt = [node for bus in look.gateway.buses for node in bus.nmt]
        state = f"{nmt.count(NmtState.OPERATIONAL)} of {len(nmt)} nodes operational"
    others = {each.service for each in peers if each.skin == peer.skin} - {peer.service}
    mine = [each.code for each in look.notices if each.subject == peer.service] if look else []
    if look is None and peer.service in GATEWAYS and rate_hz == 0:  # nor does it tell the layout
        mine = [Cause.GATEWAY_SILENT.code]
    if look and peer.service in GATEWAYS:
        mine = [each.code for each in look.notices if each.subject not in others]
    return Listed(
        skin=peer.skin,
        service=peer.service,
        state=state,
        causes=list(dict.fromkeys(mine)),
        rate_hz=rate_hz,
        version=peer.version,
        scheduling=peer.scheduling,
        fingerprint=peer.fingerprint,
    )


def _layout(skin: str, peers: list[Peer], endpoint: str) -> Layout | dict[str, str]:
    """Return a skin's layout, or why it is not known."""
    if not any(knows_layout(peer) for peer in peers if peer.skin == skin):
        return {"error": "no gateway tells its layout"}
    try:
        return hub_layout(endpoint, skin)
    except BusError as error:
        return {"error": str(error)}


def _words(layout: Layout) -> str:
    buses = f"{len(layout.bus)} bus{'es' * (len(layout.bus) != 1)}"
    sums = f"{layout.measurement.sums} sums, {layout.sending}"
    return f"{layout.taxels.words}, {sums}, SYNC {layout.sync.rate_hz:g} Hz, {buses}"
