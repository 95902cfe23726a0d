"""``skin list``: the skins on a hub, their services, and what they send."""

import time
from collections import Counter
from contextlib import ExitStack, closing, suppress
from functools import partial
from typing import Any, Final

import msgspec

from canskin.errors import BusError, DeniedError
from canskin.fabric import Fabric
from canskin.messages import GATEWAY, IMAGE, LABEL, MEASUREMENT, TRUTH, GatewayStatus, NmtState, Topic
from canskin.peers import Peer
from canskin.session import DEFAULT_ENDPOINT, peers_at
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
    """A service on a hub; `rate_hz` is None if it publishes nothing, or these keys may not hear its messages."""

    skin: str
    service: str
    state: str
    rate_hz: float | None
    version: str
    scheduling: str
    fingerprint: str


def list_(*, connect: str = DEFAULT_ENDPOINT, seconds: float = 1.0, json: Json = False) -> None:
    """List the skins on a hub and their services: state, messages in a second, layout.

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
    peers = sorted(peers_at(connect, PATIENCE_S, bool, "--connect"), key=lambda peer: (peer.skin, peer.service))
    if not peers:
        raise BusError(f"no service at {connect}: start 'skin gateway', or give another --connect")
    counts, states = _heard({peer.skin for peer in peers}, connect, seconds)
    services = [_listed(peer, peers, counts, states, seconds) for peer in peers]
    layouts = {name: _about(name, peers, connect) for name in sorted({peer.skin for peer in peers})}
    if json:
        print_json({"skins": layouts, "services": services})
        return
    for name, about in layouts.items():
        print(f"{name}: {about.get('layout', about.get('error'))}")
    rows = ((each or "-" for each in map(_cell, msgspec.structs.astuple(service))) for service in services)
    print_table(["skin", "service", "state", "messages/s", "version", "scheduling", "Φ"], rows)


def _cell(value: Any) -> str:
    return "" if value is None else f"{value:.1f}" if isinstance(value, float) else str(value)


def _heard(skins: set[str], endpoint: str, seconds: float) -> tuple[Counter[tuple[str, str]], dict[str, GatewayStatus]]:
    """Return how many messages of each skin and topic came in a time, and the newest counters of the gateways.

    Topics that the role of the keys may not hear are missing, as are those of other skins.
    """
    counts: Counter[tuple[str, str]] = Counter()
    states: dict[str, GatewayStatus] = {}

    def count(key: tuple[str, str], *_: object) -> None:
        counts[key] += 1

    with ExitStack() as stack:
        for skin in skins:
            # Without a name: the other services do not see this program come and go.
            fabric = stack.enter_context(closing(Fabric(skin, "", endpoint, patience_s=PATIENCE_S)))
            with suppress(DeniedError):
                fabric.subscribe(GATEWAY, partial(states.__setitem__, skin))
            for topic in {each.name: each for each in SENT.values()}.values():
                with suppress(DeniedError):
                    fabric.subscribe_bytes(topic, partial(count, (skin, topic.name)))
                    counts.setdefault((skin, topic.name), 0)
        time.sleep(seconds)
    return counts, states


def _listed(
    peer: Peer,
    peers: list[Peer],
    counts: Counter[tuple[str, str]],
    states: dict[str, GatewayStatus],
    seconds: float,
) -> Listed:
    topic = SENT.get(peer.service)
    told = None if topic is None else counts.get((peer.skin, topic.name))
    rate_hz = None if told is None else told / seconds
    state, gateway = "runs" if rate_hz is None else "sends" if rate_hz else "silent", states.get(peer.skin)
    if peer.service == "gateway" and gateway is not None:
        nmt = [node for bus in gateway.buses for node in bus.nmt]
        state = f"{nmt.count(NmtState.OPERATIONAL)} of {len(nmt)} nodes operational"
    masters = {each.fingerprint for each in peers if each.skin == peer.skin and each.service in {"gateway", "replay"}}
    if peer.fingerprint and masters and peer.fingerprint not in masters:
        state = "has another layout than the gateway"
    return Listed(
        skin=peer.skin,
        service=peer.service,
        state=state,
        rate_hz=rate_hz,
        version=peer.version,
        scheduling=peer.scheduling,
        fingerprint=peer.fingerprint,
    )


def _about(skin: str, peers: list[Peer], endpoint: str) -> dict[str, str]:
    """Return a skin's layout in words, or why it is not known."""
    if not any(knows_layout(peer) for peer in peers if peer.skin == skin):
        return {"error": "no gateway tells its layout"}
    try:
        return {"layout": _words(hub_layout(endpoint, skin))}
    except BusError as error:
        return {"error": str(error)}


def _words(layout: Layout) -> str:
    buses = f"{len(layout.bus)} bus{'es' * (len(layout.bus) != 1)}"
    sums = f"{layout.measurement.sums} sums, {layout.sending}"
    return f"{layout.taxels.words}, {sums}, SYNC {layout.sync.rate_hz:g} Hz, {buses}"
