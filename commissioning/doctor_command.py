"""``skin doctor``: what is wrong with a skin, worst first, and what mends it."""

import re
import shlex
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing
from statistics import fmean
from typing import Final, Literal

import msgspec

from bandwidth.plan import bus_time, cycle_hz, random_bus_time
from bandwidth.traffic import traffic
from bus.interface import InterfaceError, Wanted, check_interface, read_interface
from bus.link import ARBITRATED, SOCKETCAN, Link
from bus.options import BusOptions, channels, closing_links, open_links
from canskin.errors import BusError, DeniedError, InputError
from canskin.fabric import Fabric
from canskin.keys import accepts, environment_keys
from canskin.messages import GATEWAY, GatewayStatus
from canskin.peers import Peer
from canskin.session import checked, peers_at
from commissioning.bus_look import BusLook
from commissioning.talk import take_turn
from dbc.contract import Contract
from health.causes import ERROR, GRAVE, INFO, WARNING, Cause
from health.feed import Watched
from health.host_time import measure, settings
from health.snapshot import Notice, Snapshot
from shell.skin_options import SkinOptions, hub_layout, knows_layout
from shell.terminal import Json, arguments, print_json
from skin.layout import Bus, Layout, load_layout

#: Time in which the hub is heard: services that send nothing are then known.
LISTEN_S: Final = 2.0
#: Longest wait for the gateway, and for its layout.
PATIENCE_S: Final = 1.0
#: Part of a bus beyond its plan that SDO transfers may take.
SDO_RATIO: Final = 0.02
#: What to do with a hub that hangs.
_HANGS: Final = "end the process that listens there, by kill -9 if it hangs, and start it again"
#: Settings of the host that are told before anything is late.
_ADVISED: Final = ("scheduling", "clock source", "timer", "wall clock")


def doctor(
    subject: Literal["time"] | None = None,
    *,
    of: SkinOptions | None = None,
    can: BusOptions | None = None,
    seconds: float | None = None,
    json: Json = False,
) -> int:
    """Tell in five seconds what is wrong with a skin, worst first, each with its cause and what mends it.

    Beside a gateway it hears what all services tell, and sends nothing on the buses. Without one it looks at the
    interfaces, and reads the configuration of all boards by SDO; it writes nothing. Exit code 1: something is wrong.

    Parameters
    ----------
    subject
        ``time``: measure in place of that how exactly this host wakes a service, and name the settings that would make
        it better. Run it as the user of the services, while the robot's other programs run.
    of
        Which skin; without a gateway and ``--layout`` the default skin.
    can
        The CAN interfaces. Beside a gateway, settings of SocketCAN's are compared if ``-c`` names them.
    seconds
        ``time``: time of the measurement, 5 by default; Ctrl-C ends it.
    json
        Print one JSON object.

    Examples
    --------
    skin doctor
    skin doctor --layout palm.toml -i socketcan -c can0
    skin doctor time --layout palm.toml --seconds 60 --json
    """
    of = of or SkinOptions()
    if subject == "time":
        if can is not None:
            raise InputError("expected no CAN interface with 'skin doctor time': it looks at the host alone")
        measure(of.find(needs_hub=False), 5.0 if seconds is None else seconds, as_json=json)
        return 0
    if seconds is not None:
        raise InputError("--seconds is for 'skin doctor time'")
    name, found = examine(of, can or BusOptions())
    found = [msgspec.structs.replace(each, mend=_typed(each.mend, of, can)) for each in found]
    is_wrong = any(each.level != INFO for each in found)
    if json:
        print_json({"skin": name, "is_well": not is_wrong, "findings": found})
        return int(is_wrong)
    for each in found:
        since = ""
        if each.since_time_s is not None:
            since = time.strftime(" (since %F %T)", time.localtime(each.since_time_s))
        print(f"{each.level}: {each.text}{since} [{each.code}]\n    {each.mend}")
    counts = {level: sum(each.level == level for each in found) for level in (ERROR, WARNING)}
    told = ", ".join(f"{count} {level}{'s' * (count != 1)}" for level, count in counts.items() if count)
    print(f"{name}: {told or 'nothing is wrong'}")
    return int(is_wrong)


def examine(of: SkinOptions, can: BusOptions) -> tuple[str, list[Notice]]:
    """Return the name of a skin, and what is wrong with it, worst first.

    Raises
    ------
    SkinError
        If the options cannot be used, or name no single skin.
    """
    from can import VALID_INTERFACES

    if can.interface not in VALID_INTERFACES:
        known = ", ".join(sorted(VALID_INTERFACES))
        raise InputError(f"expected --interface with one of {known}, got {can.interface!r}")
    skin, has_gateway, found = _find(of)
    snapshot = None
    if skin is not None:
        contract = Contract.from_layout(skin)
        names = channels(skin, can)
        with ExitStack() as stack:
            look, told = None, list[GatewayStatus]()
            if not found:  # there is a hub
                fabric = Fabric(skin.name, "", of.endpoint, patience_s=PATIENCE_S)
                look = Watched(skin, stack.enter_context(closing(fabric)))
                fabric.subscribe(GATEWAY, told.append)
            if not has_gateway:  # a gateway does not start without its buses: they come first
                found = _look_at_buses(contract, of, can, names) + found
            else:
                if can.interface == SOCKETCAN and can.channel:
                    found += [each for pair in zip(names, skin.bus, strict=True) for each in _differences(*pair)]
                time.sleep(LISTEN_S)
            if look is not None:
                snapshot = look.look()
                found += [_graver(each) for each in snapshot.notices]
                if has_gateway and "classifier" not in snapshot.services:
                    text = "no labels: no classifier is there"
                    found.append(Cause.SERVICE_ABSENT.notice(text, "classifier", level=INFO))
                found += _loads(contract, told)
    name = skin.name if skin is not None else of.skin or "skin"
    return name, sorted([*found, *_host(snapshot)], key=lambda each: GRAVE.index(each.level))


def _find(of: SkinOptions) -> tuple[Layout | None, bool, list[Notice]]:
    """Return the layout, whether a gateway of the skin is there, and why hub or gateway cannot be asked."""
    endpoint, _ = checked(of.endpoint, environment_keys())  # a wrong endpoint is no fault of the skin
    given = None if of.layout is None else of.find(needs_hub=False)
    wanted = of.skin if given is None else given.name

    def tells(peer: Peer) -> bool:
        return knows_layout(peer) and wanted in {None, peer.skin}

    try:
        peers = peers_at(of.endpoint, PATIENCE_S, lambda peers: any(map(tells, peers)), "--connect")
    except BusError as error:
        if accepts(endpoint):  # whoever hangs there may have the buses, too
            return None, True, [Cause.HUB_AWAY.notice(str(error), "hub", mend=_HANGS)]
        mend = "" if given else f"{Cause.HUB_AWAY.mend}; give --layout if the skin is not the default one"
        return given or load_layout(None), False, [Cause.HUB_AWAY.notice(str(error), "hub", mend=mend)]
    skins = {peer.skin for peer in peers if tells(peer)}
    if given is not None or not (skins or of.skin):
        return given or load_layout(None), bool(skins), []
    try:
        return hub_layout(of.endpoint, of.skin, patience_s=PATIENCE_S), True, []
    except BusError as error:
        if len(skins) != 1 or isinstance(error, DeniedError):
            raise
        return None, True, [Cause.GATEWAY_SILENT.notice(str(error), "gateway")]


def _typed(mend: str, of: SkinOptions, can: BusOptions | None) -> str:
    """Return what to do with the options of this command in the commands that need them, too."""
    asking, at_buses = arguments(of), arguments(can) if can else []
    beside, alone = [*asking, *at_buses], [*arguments(SkinOptions(of.layout)), *at_buses]
    given = {
        "reconstruct": asking,
        "tare": asking,
        "calibration show": asking,
        "scan": beside,
        "load": beside,
        "node check": alone,
        "commission": alone,
        "gateway": alone,
    }
    verb = rf"'skin ({'|'.join(given)})([^']*)'"
    return re.sub(verb, lambda found: f"'{shlex.join(['skin', *found[1].split(), *given[found[1]]])}{found[2]}'", mend)


def _graver(notice: Notice) -> Notice:
    """Return a notice as an error that is none while a skin starts."""
    is_absent = notice.code == Cause.GATEWAY_ABSENT.code
    return msgspec.structs.replace(notice, level=ERROR) if is_absent else notice


def _look_at_buses(contract: Contract, of: SkinOptions, can: BusOptions, names: list[str]) -> list[Notice]:
    """Look at interfaces and boards, without a gateway."""
    found: list[Notice] = []
    virtual = f"'skin bus{f' --layout {of.layout}' if of.layout else ''}'" if can.interface == ARBITRATED else ""
    absent: dict[str, BusError] = {}
    opened: dict[int, Link] = {}
    with closing_links(opened) as links:
        for number, (channel, line) in enumerate(zip(names, contract.layout.bus, strict=True)):
            if can.interface == SOCKETCAN:
                found += (settings := _differences(channel, line))
                if any(each.level == ERROR for each in settings):
                    continue
            try:
                opened.update(open_links(contract.layout, can, [number], name="doctor", wait_s=0.0))
            except InterfaceError as error:
                mend = virtual and f"stop that bus, then {virtual}"
                found.append(Cause.INTERFACE_DIFFERS.notice(f"{line.name}: {error}", line.name, mend=mend))
            except BusError as error:
                absent[line.name] = error
        found += _absent(absent, virtual)
        now_s = time.monotonic()
        looks = {number: BusLook(contract, number, link, now_s) for number, link in links.items()}
        while not all(each.done for each in looks.values()):
            take_turn(links, looks)
    return found + [notice for each in looks.values() for notice in each.notices()]


def _absent(errors: dict[str, BusError], virtual: str) -> Iterator[Notice]:
    """Name the buses that could not be opened; all virtual ones together, which one command starts."""
    if virtual and errors:
        named, more = ", ".join(errors), f"; and {len(errors) - 1} more" * (len(errors) > 1)
        mend = f"{virtual}, or give the interface of real buses: -i socketcan -c can0"
        yield Cause.INTERFACE_LOST.notice(f"{named}: {next(iter(errors.values()))}{more}", named, mend=mend)
    elif errors:
        yield from (Cause.INTERFACE_LOST.notice(f"{name}: {error}", name) for name, error in errors.items())


def _differences(channel: str, line: Bus) -> list[Notice]:
    """Tell how an interface of SocketCAN differs from what the layout wants."""
    try:
        about = read_interface(channel)
    except OSError as error:
        text = f"{line.name}: no interface {channel}: {error.strerror or error}"
        return [Cause.INTERFACE_LOST.notice(text, line.name)]
    try:
        text, level = check_interface(channel, about, Wanted(line.bitrate, line.data_bitrate, fd=line.fd)), WARNING
    except InterfaceError as error:
        text, level = str(error), ERROR
    words, _, command = text.rpartition(": '")
    told = Cause.INTERFACE_DIFFERS.notice(f"{line.name}: {words}", line.name, level=level, mend=command.rstrip("'"))
    return [told] if text else []


def _loads(contract: Contract, told: list[GatewayStatus]) -> Iterator[Notice]:
    """Compare the loads that the gateway tells with the plan."""
    rate_hz = cycle_hz(contract.layout)
    for number, line in enumerate(contract.layout.bus):
        load_ratio = fmean([bus.load_ratio for each in told for bus in each.buses if bus.name == line.name] or [0.0])
        turns = [traffic(contract, number, turn) for turn in range(contract.turns)]
        most = max(bus_time(each, "worst").load(rate_hz) for each in turns)
        if load_ratio > most + SDO_RATIO:
            usual = fmean(random_bus_time(each).load(rate_hz) for each in turns)
            text = f"{line.name}: load {load_ratio:.1%}, planned are {usual:.1%}, and {most:.1%} at most"
            yield Cause.BUS_LOAD_ABOVE_PLAN.notice(text, line.name)


def _host(snapshot: Snapshot | None) -> Iterator[Notice]:
    """Advise on settings of this host, all of them where something is late."""
    if sys.platform != "linux":
        return
    gateway = snapshot.services.get("gateway") if snapshot else None
    is_late = snapshot is not None and any(each.code == Cause.HOST_LATE.code for each in snapshot.notices)
    for each in settings(gateway.scheduling if gateway else ""):
        if each.mend and (is_late or each.name in _ADVISED):
            text, level = f"this host: {each.name}: {each.value}", WARNING if is_late else INFO
            yield Cause.HOST_SETTING.notice(text, each.name, level=level, mend=each.mend)
