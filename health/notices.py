"""Notices for the user, made from the snapshot alone: what stopped, when, and which service is the cause."""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from typing import Final

import msgspec

from canskin.calibration_messages import CalibrationState
from health.causes import GRAVE, WARNING, Cause
from health.nodes_why import link_cause
from health.snapshot import BusView, NodeTrouble, Notice, Service, Snapshot

#: Most node-IDs named in one notice, where tiles show the others, and most defects and contacts in doubt.
NAMED: Final = 8
#: A force that has been in doubt for less is no news: most of them move again.
DOUBTED_S: Final = 10.0
#: A gateway that has run for longer is no longer starting, s.
STARTED_S: Final = 30.0
#: Above this load a bus is full: the rest of the time is between frames.
FULL_RATIO: Final = 0.97
#: So many nodes at an end of a bus that fall silent within this time are a broken cable.
BROKEN_AT_LEAST: Final = 2
TOGETHER_S: Final = 2.0
#: A larger error of the clock between two machines is told, s: half a cycle at 100 Hz.
CLOCK_ERROR_S: Final = 0.005
_SILENT: Final = (Cause.NODE_SILENT.code, Cause.NODE_ABSENT.code)
#: Beside such nodes no cable is broken: all of them come back, one after another, or a board fills the bus.
_NOT_BROKEN: Final = {Cause.NODE_BOOTED.code, Cause.NODE_STARTING.code, Cause.NODE_TWICE.code}
#: What is wrong with a bus: the cause, what of the bus, the text, and the level, empty for that of the cause.
_Told = tuple[Cause, str, str, str]
#: A gateway that has sent no counters for this time, two in place of one, sends no measurements.
MISSED_S: Final = 0.4


def display_name(service: str) -> str:
    """Return the words for the service that shows the skin."""
    return "this page" if service == "viewer" else f"this {service}"


def notices(state: Snapshot, own: str, *, is_grid: bool) -> Snapshot:
    """Return `state` with its notices, errors first; `own` is the name of the service that shows the skin."""
    if state.cut_off:  # the state of the other services is then unknown
        text = "nothing arrives: the fabric's hub, usually the gateway, is out of reach"
        found = [Cause.HUB_AWAY.notice(text, "hub", state.services[own].since_time_s)]
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
    return msgspec.structs.replace(state, notices=sorted(found, key=lambda notice: GRAVE.index(notice.level)))


def _gateway(state: Snapshot, own: str) -> Iterator[Notice]:
    token, status = state.services.get("gateway"), state.gateway
    if token is not None and not token.alive:
        yield Cause.GATEWAY_GONE.notice("measurements stopped: gateway is gone", "gateway", token.since_time_s)
    elif status is not None and status.stale:
        text = "the state of the buses is unknown: gateway sends no status"
        yield Cause.GATEWAY_SILENT.notice(text, "gateway", state.time_s - status.age_s)
    elif status is None:
        yield Cause.GATEWAY_ABSENT.notice("waiting for the gateway", "gateway")
        if token is None and state.other_skins:
            others = ", ".join(f"'{name}'" for name in state.other_skins)
            shown = f"{display_name(own)} shows skin '{state.skin}'"
            yield Cause.OTHER_SKIN.notice(f"{shown}, and on its hub is {others}: give both the same --layout")
    elif status.cycles == 0:
        yield Cause.STARTING.notice("gateway is booting the nodes; SYNC has not started", "gateway")


def _misfits(state: Snapshot) -> Iterator[Notice]:
    """Name services with another Φ or another version, and those that lose messages."""
    for name, service in state.services.items():
        if service.alive and service.loses_since_time_s is not None:
            text = f"{name} is too slow: {service.lost} messages are lost so far"
            yield Cause.SERVICE_DROPS.notice(text, name, service.loses_since_time_s)
        if service.alive and (error_s := service.clock_error_s or 0.0) > CLOCK_ERROR_S:
            text = f"{name} knows the clock of the gateway's machine to {1e3 * error_s:.0f} ms"
            yield Cause.CLOCK_UNSURE.notice(text, name)
        if service.alive and service.difference:
            yield Cause.SERVICE_DIFFERS.notice(service.difference, name, service.since_time_s)


def _images(state: Snapshot) -> Iterator[Notice]:
    token, image = state.services.get("reconstructor"), state.image
    if image is not None and image.stale:
        cause, why = _why(state, token)
        yield cause.notice(f"images stopped: {why}", "reconstructor", state.time_s - image.age_s)
    elif image is None and token is not None and not token.alive:
        yield Cause.SERVICE_GONE.notice("no images: reconstructor is gone", "reconstructor", token.since_time_s)
    elif image is None and token is not None and token.silent:
        yield Cause.SERVICE_SILENT.notice("no images: reconstructor is there but sends none", "reconstructor")
    elif image is None:
        status = state.gateway
        is_starting = status is None or status.cycles < STARTED_S * status.sync_rate_hz
        if state.services and token is None and not is_starting:
            yield Cause.SERVICE_ABSENT.notice("no images: no reconstructor is there", "reconstructor")
        else:
            level = "" if is_starting else WARNING
            yield Cause.NO_IMAGE.notice("waiting for the first image", "reconstructor", level=level)


def _why(state: Snapshot, token: Service | None) -> tuple[Cause, str]:
    """Name the service because of which no images come; without any token, as in recordings, no service is known."""
    if not state.services:
        return Cause.SERVICE_SILENT, "no more came"
    if token is None or not token.alive:
        return Cause.SERVICE_GONE, "reconstructor is gone"
    gateway = state.services.get("gateway")
    if gateway is None or not gateway.alive:
        return Cause.GATEWAY_GONE, "no measurements without the gateway"
    if state.gateway is not None and not _measures(state):
        return Cause.GATEWAY_SILENT, "gateway sends nothing"
    return Cause.SERVICE_SILENT, "reconstructor is there but sends none"


def _labels(state: Snapshot) -> Iterator[Notice]:
    token, label = state.services.get("classifier"), state.label
    if token is not None and not token.alive:
        yield Cause.SERVICE_GONE.notice("labels stopped: classifier is gone", "classifier", token.since_time_s)
    elif label is not None and label.stale and _measures(state):
        is_there = not state.services or token is not None
        cause = Cause.SERVICE_SILENT if is_there else Cause.SERVICE_GONE
        why = "classifier is there but sends none" if token else "classifier is gone"
        text = f"labels stopped: {why if state.services else 'no more came'}"
        yield cause.notice(text, "classifier", state.time_s - label.age_s)


def _nodes(state: Snapshot) -> Iterator[Notice]:
    for name, token in state.services.items():
        if (name == "nodes" or name.startswith("nodes-")) and not token.alive:
            text = f"no sums from the virtual {name}: the process is gone"
            yield Cause.SERVICE_GONE.notice(text, name, token.since_time_s)


def _buses(state: Snapshot) -> Iterator[Notice]:
    if state.gateway is None or state.gateway.stale:
        return
    yield from notices_of(state.gateway.buses)
    if state.image is not None and not state.image.stale and state.image.valid_sums == 0:
        yield Cause.NOTHING_MEASURED.notice("nothing is measured: no block sent its sums")
    if state.gateway.late_since_time_s is not None:
        text = f"the gateway's host is late: {state.gateway.late}"
        yield Cause.HOST_LATE.notice(text, "gateway", state.gateway.late_since_time_s)


def notices_of(buses: Sequence[BusView]) -> Iterator[Notice]:
    """Return what is wrong with buses and their nodes: one notice for what several buses have in common."""
    for text, bus in {bus.trouble: bus for bus in buses if bus.trouble}.items():
        names = [each.name for each in buses if each.trouble == text]
        named = ", ".join(names)
        cause = link_cause(bus) or Cause.SYNC_REFUSED
        yield cause.notice(f"{'buses' if len(names) > 1 else 'bus'} {named} {text}", named, level=bus.level)
    groups: defaultdict[_Told, list[tuple[str, float | None]]] = defaultdict(list)
    for bus in buses:
        for told, since_time_s in _of_bus(bus):
            groups[told].append((bus.name, since_time_s))
    for (cause, about, text, level), found in groups.items():
        named = ", ".join(name for name, _ in found)
        since_time_s = min((at_s for _, at_s in found if at_s is not None), default=None)
        yield cause.notice(f"{named}: {text}", f"{named} {about}".strip(), since_time_s, level)


def _of_bus(bus: BusView) -> Iterator[tuple[_Told, float | None]]:
    """Return what is wrong with one bus and its nodes, and since when."""
    if bus.other_sync:
        yield (Cause.OTHER_SYNC, "", f"another SYNC producer: {bus.other_sync}", ""), None
    if bus.load_ratio > FULL_RATIO and not bus.dead:
        yield (Cause.BUS_FULL, "", f"the bus is full, {100 * bus.load_ratio:.0f} %", ""), None
    if not bus.dead:
        yield from _off_duty(bus)


def _calibration(state: Snapshot) -> Iterator[Notice]:
    """Tell that the skin has no zero yet, and name its defects."""
    if state.gateway is None or state.gateway.stale or state.gateway.calibration is None:
        return
    calibration = state.gateway.calibration
    if calibration.state is CalibrationState.TOUCHED:
        text = "the zero of the skin is not measured: something has touched the skin since the start"
        yield Cause.NO_ZERO.notice(text)
    if calibration.recalibrated:
        named, more = calibration.recalibrated[:NAMED], len(calibration.recalibrated) - NAMED
        nodes = ", ".join(named) + (f" and {more} more" if more > 0 else "")
        text = f"gains or offsets of {nodes} have changed: forces there are doubtful until that is accepted (skin tare)"
        yield Cause.GAINS_CHANGED.notice(text)
    for text in calibration.defects[:NAMED]:
        yield Cause.DEFECT.notice(text, text)
    if len(calibration.defects) > NAMED:
        yield Cause.DEFECT.notice(f"{len(calibration.defects) - NAMED} more defects: skin calibration show", "more")


def _doubts(state: Snapshot, *, is_grid: bool) -> Iterator[Notice]:
    """Name contacts that may be errors of the zero, and what a person can do."""
    known = state.contacts
    if known is None or known.stale or known.blind:
        return
    doubtful = [
        (each, (known.sampled_mono_ns - each.doubtful_since_mono_ns) * 1e-9) for each in known.contacts if each.doubtful
    ]
    doubtful = [(each, lasts_s) for each, lasts_s in doubtful if lasts_s >= DOUBTED_S]
    for each, lasts_s in doubtful[:NAMED]:
        where = f"row {each.row:.0f}, column {each.column:.0f}" if is_grid else f"taxel {each.column:.0f}"
        force = f"a force of {each.force_n:.3g} N around {where}"
        # Elsewhere the numbers of a contact's taxels have others between them.
        region = f" --region {each.top},{each.left},{each.bottom},{each.right}" if is_grid else ""
        why = "a still weight, or an error of the zero, as of a warm patch; if nothing touches there"
        text = f"{force} has been in doubt for {lasts_s:.0f} s: {why}: skin tare{region}"
        mend = f"'skin tare{region}' if nothing touches there"
        yield Cause.DOUBTFUL_FORCE.notice(text, f"contact {each.identity}", mend=mend)
    if len(doubtful) > NAMED:
        yield Cause.DOUBTFUL_FORCE.notice(f"{len(doubtful) - NAMED} more contacts are in doubt", "more contacts")


def _thresholds(state: Snapshot) -> Iterator[Notice]:
    """Name the regions whose force is above their threshold."""
    for each in state.patches:
        if each.is_over and each.peak_n is not None:
            text = f"up to {each.peak_n:.3g} N on {each.name}: more than its threshold of {each.threshold_n:g} N"
            yield Cause.THRESHOLD.notice(text, each.name, each.over_since_time_s)


def _off_duty(bus: BusView) -> Iterator[tuple[_Told, float | None]]:
    """Name the nodes of a bus that are not whole, together for each reason."""
    if (place := _broken_at(bus)) is not None:
        yield place
        return
    groups: defaultdict[tuple[str, str], list[NodeTrouble]] = defaultdict(list)
    for each in bus.nodes_why:
        groups[each.code, each.word].append(each)
    for (code, word), found in groups.items():
        nodes = [each.node for each in found]
        named = ", ".join(map(str, nodes[:NAMED])) + (f" and {len(nodes) - NAMED} more" if len(nodes) > NAMED else "")
        who = "all nodes" if len(nodes) == len(bus.nodes) else f"node{'s' * (len(nodes) > 1)} {named}"
        seen = sorted({each.why.removeprefix(word).lstrip(":, ") for each in found} - {""})
        evidence = f" ({seen[0]}{f'; and {len(seen) - 1} more' * (len(seen) > 1)})" if seen else ""
        since_time_s = min(each.since_time_s for each in found)
        cause = Cause.of(code)
        is_free = cause is Cause.NODE_AWAY  # whatever the rest of the bus does
        level = cause.level if is_free else min(bus.level, cause.level, key=GRAVE.index)
        yield (cause, word, f"{who} {word}{evidence}", level), since_time_s


def _broken_at(bus: BusView) -> tuple[_Told, float | None] | None:
    """Tell that the cable is broken: all nodes from one place to an end are silent since one time, the others not."""
    silent = {each.node: each.since_time_s for each in bus.nodes_why if each.code in _SILENT}
    gone = [node in silent for node in bus.nodes]
    count = sum(gone)
    if count < BROKEN_AT_LEAST or count == len(gone) or max(silent.values()) - min(silent.values()) > TOGETHER_S:
        return None
    place = len(gone) - count if all(gone[-count:]) else count if all(gone[:count]) else None
    if place is None:
        return None
    others = {each.code for each in bus.nodes_why} & _NOT_BROKEN
    if others:
        return None
    where = f"between node {bus.nodes[place - 1]} and node {bus.nodes[place]}"
    named = ", ".join(map(str, silent))
    text = f"nodes {named} are silent since one time: the cable is broken, or without supply, {where}"
    return (Cause.CABLE_BREAK, where, text, ""), min(silent.values())


def _ignored(state: Snapshot) -> Iterator[Notice]:
    if state.ignored:
        text = f"{state.ignored} messages ignored that do not fit this skin: is every service given the same layout?"
        yield Cause.MISFITS.notice(text)


def _measures(state: Snapshot) -> bool:
    return state.gateway is not None and not state.gateway.stale and state.gateway.age_s <= MISSED_S
