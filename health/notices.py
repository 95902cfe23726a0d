"""Notices for the user, made from the snapshot alone: what stopped, when, and which service is the cause."""

from collections.abc import Iterator
from typing import Final

import msgspec

from canskin.calibration_messages import CalibrationState
from health.nodes_why import FROZEN, NMT_WORDS, REFUSED, word_of
from health.snapshot import BusView, Notice, Service, Snapshot

#: Most node-IDs named in one notice, where tiles show the others, and most defects and contacts in doubt.
NAMED: Final = 8


def display_name(service: str) -> str:
    """Return the words for the service that shows the skin."""
    return "this page" if service == "viewer" else f"this {service}"


def notices(state: Snapshot, own: str, *, is_grid: bool) -> Snapshot:
    """Return `state` with its notices, errors first; `own` is the name of the service that shows the skin."""
    if state.cut_off:  # the state of the other services is then unknown
        text = "nothing arrives: the fabric's hub, usually the gateway, is out of reach"
        found = [_error(text, state.services[own].since_time_s)]
    else:
        found = [
            *_gateway(state, own),
            *_misfits(state),
            *_images(state),
            *_labels(state),
            *_nodes(state),
            *_buses(state),
        ]
        found += [*_calibration(state), *_doubts(state, is_grid=is_grid), *_thresholds(state)]
    found += _ignored(state)
    grave = ("error", "warning", "info")
    return msgspec.structs.replace(state, notices=sorted(found, key=lambda notice: grave.index(notice.level)))


def _gateway(state: Snapshot, own: str) -> Iterator[Notice]:
    token, status = state.services.get("gateway"), state.gateway
    if token is not None and not token.alive:
        yield _error("measurements stopped: gateway is gone", token.since_time_s)
    elif status is not None and status.stale:
        yield _error("the state of the buses is unknown: gateway sends no status", state.time_s - status.age_s)
    elif status is None:
        yield Notice(level="info", text="waiting for the gateway")
        if token is None and state.other_skins:
            others = ", ".join(f"'{name}'" for name in state.other_skins)
            shown = f"{display_name(own)} shows skin '{state.skin}'"
            text = f"{shown}, and on its hub is {others}: give both the same --layout"
            yield Notice(level="warning", text=text)
    elif status.cycles == 0:
        yield Notice(level="info", text="gateway is booting the nodes; SYNC has not started")


def _misfits(state: Snapshot) -> Iterator[Notice]:
    """Name services with another Φ or another version."""
    for service in state.services.values():
        if service.alive and service.difference:
            yield _error(service.difference, service.since_time_s)


def _images(state: Snapshot) -> Iterator[Notice]:
    token, image = state.services.get("reconstructor"), state.image
    if image is None:
        if token is not None and not token.alive:
            yield _error("no images: reconstructor is gone", token.since_time_s)
        else:
            yield Notice(level="info", text="waiting for the first image")
    elif image.stale:
        yield _error(f"images stopped: {_why(state, token)}", state.time_s - image.age_s)


def _why(state: Snapshot, token: Service | None) -> str:
    """Name the service because of which no images come; without any token, as in recordings, no service is known."""
    if not state.services:
        return "no more came"
    if token is None or not token.alive:
        return "reconstructor is gone"
    gateway = state.services.get("gateway")
    if gateway is None or not gateway.alive:
        return "no measurements without the gateway"
    return "reconstructor is there but sends none"


def _labels(state: Snapshot) -> Iterator[Notice]:
    token, label = state.services.get("classifier"), state.label
    if token is not None and not token.alive:
        yield Notice(level="error", text="labels stopped: classifier is gone", since_time_s=token.since_time_s)
    elif label is not None and label.stale and _measures(state):
        since_time_s = state.time_s - label.age_s
        why = "classifier is there but sends none" if token else "classifier is gone"
        yield _error(f"labels stopped: {why if state.services else 'no more came'}", since_time_s)


def _nodes(state: Snapshot) -> Iterator[Notice]:
    for name, token in state.services.items():
        if (name == "nodes" or name.startswith("nodes-")) and not token.alive:
            yield _error(f"no sums from the virtual {name}: the process is gone", token.since_time_s)


def _buses(state: Snapshot) -> Iterator[Notice]:
    if state.gateway is None or state.gateway.stale:
        return
    troubles = {bus.trouble: bus for bus in state.gateway.buses if bus.trouble}
    for text, bus in troubles.items():
        names = [each.name for each in state.gateway.buses if each.trouble == text]
        named = f"{'buses' if len(names) > 1 else 'bus'} {', '.join(names)} {text}"
        yield Notice(level=bus.level, text=named)
    if state.image is not None and not state.image.stale and state.image.valid_sums == 0:
        yield Notice(level="error", text="nothing is measured: no block sent its sums")
    for bus in state.gateway.buses:
        if not bus.dead:
            yield from _off_duty(bus)


def _calibration(state: Snapshot) -> Iterator[Notice]:
    """Tell that the skin has no zero yet, and name its defects."""
    if state.gateway is None or state.gateway.stale or state.gateway.calibration is None:
        return
    calibration = state.gateway.calibration
    if calibration.state is CalibrationState.TOUCHED:
        text = "the zero of the skin is not measured: something has touched the skin since the start"
        yield Notice(level="info", text=text)
    if calibration.recalibrated:
        named, more = calibration.recalibrated[:NAMED], len(calibration.recalibrated) - NAMED
        nodes = ", ".join(named) + (f" and {more} more" if more > 0 else "")
        text = f"gains or offsets of {nodes} have changed: forces there are doubtful until that is accepted (skin tare)"
        yield Notice(level="warning", text=text, kind="recalibrated")
    for text in calibration.defects[:NAMED]:
        yield Notice(level="warning", text=text)
    if len(calibration.defects) > NAMED:
        text = f"{len(calibration.defects) - NAMED} more defects: skin calibration show"
        yield Notice(level="warning", text=text, kind="more defects")


def _doubts(state: Snapshot, *, is_grid: bool) -> Iterator[Notice]:
    """Name contacts that may be errors of the zero, and what a person can do."""
    known = state.contacts
    if known is None or known.stale or known.blind:
        return
    doubtful = [each for each in known.contacts if each.doubtful]
    for each in doubtful[:NAMED]:
        where = f"row {each.row:.0f}, column {each.column:.0f}" if is_grid else f"taxel {each.column:.0f}"
        force = f"a force of {each.force_n:.3g} N around {where}"
        lasts_s = (known.sampled_mono_ns - each.doubtful_since_mono_ns) * 1e-9
        # Elsewhere the numbers of a contact's taxels have others between them.
        region = f" --region {each.top},{each.left},{each.bottom},{each.right}" if is_grid else ""
        why = "a still weight, or an error of the zero, as of a warm patch; if nothing touches there"
        text = f"{force} has been in doubt for {lasts_s:.0f} s: {why}: skin tare{region}"
        yield Notice(level="warning", text=text, kind=f"doubtful contact {each.identity}")
    if len(doubtful) > NAMED:
        text = f"{len(doubtful) - NAMED} more contacts are in doubt"
        yield Notice(level="warning", text=text, kind="more doubtful contacts")


def _thresholds(state: Snapshot) -> Iterator[Notice]:
    """Name the regions whose force is above their threshold."""
    for each in state.patches:
        if each.is_over and each.peak_n is not None:
            text = f"up to {each.peak_n:.3g} N on {each.name}: more than its threshold of {each.threshold_n:g} N"
            yield Notice(
                level="warning", text=text, since_time_s=each.over_since_time_s, kind=f"threshold of {each.name}"
            )


def _off_duty(bus: BusView) -> Iterator[Notice]:
    """Name the nodes of a bus that do not measure, one notice for each reason."""
    for word, nodes in _nodes_of_word(bus).items():
        if nodes and len(nodes) == len(bus.nodes):
            yield Notice(level=bus.level, text=f"{bus.name}: all {len(nodes)} nodes {word}")
        elif nodes:
            named = ", ".join(map(str, nodes[:NAMED]))
            more = f" and {len(nodes) - NAMED} more" if len(nodes) > NAMED else ""
            plural = "s" if len(nodes) > 1 else ""
            yield Notice(level=bus.level, text=f"{bus.name}: node{plural} {named}{more} {word}")


def _nodes_of_word(bus: BusView) -> dict[str, list[int]]:
    """Sort a bus's nodes by why they do not measure."""
    found: dict[str, list[int]] = {word: [] for word in (*NMT_WORDS.values(), REFUSED, FROZEN)}
    for node, nmt in zip(bus.nodes, bus.nmt, strict=True):
        if word := word_of(bus, node, nmt):
            found[word].append(node)
    return found


def _ignored(state: Snapshot) -> Iterator[Notice]:
    if state.ignored:
        text = f"{state.ignored} messages ignored that do not fit this skin: is every service given the same layout?"
        yield Notice(level="warning", text=text, kind="ignored")


def _measures(state: Snapshot) -> bool:
    return state.gateway is not None and not state.gateway.stale


def _error(text: str, since_time_s: float) -> Notice:
    return Notice(level="error", text=text, since_time_s=since_time_s)
