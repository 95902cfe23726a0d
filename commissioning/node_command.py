"""``skin node``: a board against the contract, the wiring against the layout; objects by name; NMT commands."""

import dataclasses
import select
import time
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, Protocol

from cyclopts import Parameter

from bus.link import Link
from bus.options import BusOptions, closing_links, open_channels, open_links
from canskin.errors import InputError, RunError
from commissioning.node_check import NodeCheck
from commissioning.node_frames import NodeReport
from commissioning.talk import TURN_S, Talk, take_turn
from commissioning.update_command import update_nodes
from dbc.canopen import HIGHEST_NODE_ID, NmtCommand, state_text
from dbc.contract import Contract, NodeContract
from shell.output import write_file
from shell.service import StopSignal, say
from shell.terminal import Json, print_json, print_table
from skin.layout import Layout, load_layout, require_boards
from skin.ranges import ranges_text

if TYPE_CHECKING:
    from commissioning.count_reading import CountReading
    from commissioning.node_objects import Entry
    from commissioning.wiring_findings import Finding

#: NMT commands by the name of the action.
_ORDERS: Final = {"reset": NmtCommand.RESET_NODE, "stop": NmtCommand.STOP, "start": NmtCommand.START}


def node(
    action: Literal["check", "get", "set", "objects", "reset", "stop", "start", "update"],
    *objects: str,
    eds: Path | None = None,
    node_id: Annotated[int | None, Parameter(name="--node")] = None,
    bus: str | None = None,
    layout: Path | None = None,
    can: BusOptions | None = None,
    every: Annotated[bool, Parameter(name="--all", negative=())] = False,
    live: float | None = None,
    path: Path | None = None,
    rest: float = 1.0,
    out: Path | None = None,
    json: Json = False,
) -> int:
    """Check a board; list, read or write the objects of a node by name; reset, stop, start or update nodes.

    ``check`` compares the objects of a board, and the frames that it sends while it shows test patterns, and offsets
    in place of its taxels. It needs a bus without gateway. The board is left pre-operational, with the test patterns,
    gains and offsets that it had. Ends with 1 if the board differs from the contract.

    With ``--live`` the wiring is checked in place of a board: which taxels are not wired as the layout says, and which
    boards are exchanged.

    ``get``, ``set`` and ``objects`` may run beside the gateway, which gives way. After a write to an object that the
    layout fixes, the gateway proves the node again, and writes the layout's value (``configure = "write"``).

    ``reset``, ``stop`` and ``start`` send an NMT command to one node, or without ``--node`` to all nodes of the bus.
    They end with 1 unless each node tells the new state within 3 s. A running gateway starts nodes of the layout again.

    ``update`` loads a program (``skin contract --program``) into a board, or with ``--all`` into each board of the bus
    or of the skin that does not run it, and starts it. It may run beside the gateway. A board whose download was cut
    keeps its old program. Ends with 1 unless each board runs the program.

    Parameters
    ----------
    action
        ``check``; ``get`` and ``set``, which read and write objects by SDO; ``objects``, which lists them; ``reset``,
        ``stop`` and ``start``; ``update``.
    objects
        Of ``get``: names, or index:sub. Of ``set``: OBJECT=VALUE. Of ``objects``: a part of the names. Of ``update``:
        the file of the program.
    eds
        EDS of a device that is no board of the layout.
    node_id
        Node-ID of the board or device. ``reset``, ``stop`` and ``start``: without it all nodes of the bus.
    bus
        Name of its bus in the layout. Default: the only one.
    layout
        TOML of the skin; without it the default skin.
    can
        CAN interface and channels of all buses, as for the gateway: with ``-c can0`` the second bus is on can1. With
        `eds` and without `bus` the single channel is that of the device.
    every
        Of ``update``: all boards, of `bus` or of the skin.
    live
        Seconds in which one finger goes over the whole skin, after `rest`: the counts of all taxels are read from all
        boards. Ctrl-C ends the stroke.
    path
        CSV with the columns time_s, x_m, y_m, z_m: where the finger is after the first reading.
        Without it the place of the finger is estimated, too.
    rest
        Time without touch at the begin, seconds.
    out
        File for the corrected wiring, CSV as `measurement.chains` reads it.
    json
        Print one JSON object.

    Examples
    --------
    skin node check --bus bus0 --node 3 -i socketcan -c can0
    skin node check --layout palm.toml --node 1 --json
    skin node check --layout palm.toml --live 30 -i socketcan -c can0
    skin node check --layout palm.toml --live 30 --path finger.csv --out boards.csv
    skin node get "Producer heartbeat time" 1018h:4 --bus bus0 --node 3
    skin node set 6060h=3 --eds drive.eds --node 5 -i socketcan -c can0
    skin node reset --bus bus0 -i socketcan -c can0
    skin node update palm-1.1.bin --bus bus0 --node 3 -i socketcan -c can0
    skin node update palm-1.1.bin --all -i socketcan -c can0
    """
    skin = load_layout(layout)
    _refuse_unused(
        action,
        live,
        {"--path": path, "--out": out},
        {"--node": node_id, "--bus": bus},
        {"objects": (action != "update" and objects) or None, "EDS": eds},
    )
    if every and action != "update":
        raise InputError(f"expected --all with 'skin node update' alone, got 'skin node {action}'")
    if action == "update":
        numbers = range(len(skin.bus)) if every and bus is None else [_bus_number(skin, bus)]
        return update_nodes(skin, objects, numbers, node_id, can or BusOptions(), every=every, as_json=json)
    if action in _ORDERS:
        return _order(skin, action, _bus_number(skin, bus), node_id, can or BusOptions(), as_json=json)
    if action in ("get", "set", "objects"):
        return _objects(
            action, objects, eds=eds, skin=skin, bus=bus, node_id=node_id, can=can or BusOptions(), as_json=json
        )
    stop = StopSignal().install()
    if live is not None:
        from commissioning.wiring_check import check_counts

        reading = _read_live(skin, can or BusOptions(), live, rest, stop)
        return _show_wiring(skin, check_counts(skin, reading, path), out, as_json=json)
    if node_id is None:
        raise InputError("expected --node with the node-ID of a board, or --live")
    number = _bus_number(skin, bus)
    contract = Contract.from_layout(skin)
    board = _board(contract, number, node_id)
    with closing(open_links(skin, can or BusOptions(), [number], name="node check", stop=stop)[number]) as link:
        check = NodeCheck(contract, board, link.send, time.monotonic())
        _run(check, link, stop)
    if json:
        print_json(dataclasses.asdict(check.report))
    else:
        _show(check.report)
    return int(bool(check.report.differences))


def _refuse_unused(
    action: str,
    live: float | None,
    others: dict[str, object],
    board: dict[str, object],
    known: dict[str, object],
) -> None:
    """Refuse options that an action has no use for; `others` need `live`, which takes the whole skin."""
    given, one, named = (
        [name for name, each in of.items() if each is not None] for of in ({"--live": live} | others, board, known)
    )
    if named and action not in ("get", "set", "objects"):
        raise InputError(f"'skin node {action}' takes no {named[0]}: expected get, set or objects")
    if action != "check" and given:
        raise InputError(f"expected {' and '.join(given)} with 'skin node check' alone, got 'skin node {action}'")
    if given and live is None:
        raise InputError(f"expected {' and '.join(given)} with --live alone")
    if given and one:
        raise InputError(f"expected {' and '.join(one)} of a board, or --live of the whole skin, got both")


def _board(contract: Contract, number: int, node_id: int) -> NodeContract:
    for each in contract.on_bus(number):
        if each.node_id == node_id:
            return each
    line = contract.layout.bus[number]
    raise InputError(f"expected a node-ID of {line.name}, {ranges_text(line.ids)}, got {node_id}")


def _objects(
    action: Literal["get", "set", "objects"],
    names: Sequence[str],
    *,
    eds: Path | None,
    skin: Layout,
    bus: str | None,
    node_id: int | None,
    can: BusOptions,
    as_json: bool,
) -> int:
    """List, read or write objects of a node."""
    from commissioning.node_objects import NodeTransfers, entries_of_file, entries_of_node, find, parse_writes

    if node_id is None:
        if action != "objects":
            raise InputError(f"expected --node with a node-ID from 1 to {HIGHEST_NODE_ID}, got none")
        bus = bus or skin.bus[0].name
        node_id = skin.bus[_bus_number(skin, bus)].ids[0]
    elif not 1 <= node_id <= HIGHEST_NODE_ID:
        raise InputError(f"expected --node with a node-ID from 1 to {HIGHEST_NODE_ID}, got {node_id}")
    # A channel that is named needs no bus of the layout, if the device is none of the layout's.
    is_other = eds is not None and bus is None and len(can.channel) == 1
    number = 0 if is_other else _bus_number(skin, bus)
    if eds is None:
        contract = Contract.from_layout(skin)
        known = entries_of_node(contract, _board(contract, number, node_id))
    else:
        known = entries_of_file(eds, node_id)
    if action == "objects":
        wanted = [each for each in known if all(name.lower() in each.name.lower() for name in names)]
        _show_objects(wanted, {}, as_json=as_json)
        return 0
    if not names:
        raise InputError(f"expected 'skin node {action}' with objects, by name or index:sub; 'objects' lists them")
    writes = parse_writes(known, names) if action == "set" else []
    reads = [entry for entry, _ in writes] or [each for name in names for each in find(known, name)]
    stop = StopSignal().install()
    if is_other:
        (link,) = open_channels(can, skin.bus[0].bitrate, skin.bus[0].data_bitrate, name="node check").values()
    else:
        link = open_links(skin, can, [number], name="node check", stop=stop)[number]
    with closing(link):
        transfers = NodeTransfers(node_id, list(dict.fromkeys(reads)), link.send, time.monotonic(), writes)
        _run(transfers, link, stop)
    _show_objects(list(transfers.values), transfers.values, as_json=as_json)
    return int(any(isinstance(each, str) for each in transfers.values.values()))


def _order(skin: Layout, action: str, number: int, node_id: int | None, can: BusOptions, *, as_json: bool) -> int:
    """Send an NMT command, and show which state the nodes tell."""
    from commissioning.node_orders import NodeOrder

    if node_id is not None and not 1 <= node_id <= HIGHEST_NODE_ID:
        raise InputError(f"expected --node with a node-ID from 1 to {HIGHEST_NODE_ID}, got {node_id}")
    awaited = skin.bus[number].ids if node_id is None else [node_id]
    stop = StopSignal().install()
    with closing(open_links(skin, can, [number], name="node check", stop=stop)[number]) as link:
        order = NodeOrder(_ORDERS[action], node_id or 0, awaited, link.send, time.monotonic())
        _run(order, link, stop)
    told = {each: None if state is None else state_text(state) for each, state in order.states.items()}
    if as_json:
        print_json({"bus": skin.bus[number].name, "states": told, "missing": order.missing})
    else:
        print_table(["node", "state"], [[str(each), state or "silent"] for each, state in told.items()])
    return int(bool(order.missing))


def _show_objects(entries: "list[Entry]", values: "dict[Entry, bytes | str]", *, as_json: bool) -> None:
    """Print objects, with values where they were read."""
    rows: list[dict[str, Any]] = []
    for each in entries:
        row: dict[str, Any] = {"object": each.place, "name": each.name, "type": each.type_name}
        row |= {"unit": each.unit, "access": each.variable.access_type}
        came = values.get(each)
        if isinstance(came, str):
            row["error"] = came
        elif came is not None:
            row["value"] = each.decode(came)
        rows.append(row)
    if as_json:
        print_json(rows)
        return
    cells = [
        [row["object"], row["name"], *([_value_text(row)] if values else []), row["unit"], row["type"], row["access"]]
        for row in rows
    ]
    print_table(["object", "name", *(["value"] if values else []), "unit", "type", "access"], cells)


def _value_text(row: dict[str, Any]) -> str:
    value = row.get("value", row.get("error"))
    return f"{value} ({value:X}h)" if type(value) is int and value > 9 else str(value)


def _read_live(skin: Layout, can: BusOptions, stroke_s: float, rest_s: float, stop: StopSignal) -> "CountReading":
    """Read the counts of all boards while somebody strokes the skin."""
    from commissioning.count_reading import CountReading

    require_boards(skin)
    if skin.taxels.is_analogue:
        raise InputError("analogue boards have no counts of taxels: their wiring cannot be checked")
    with closing_links(open_links(skin, can, name="node check", stop=stop)) as links:
        say("node check", f"leave the skin alone for {rest_s:g} s")
        reading = CountReading(
            Contract.from_layout(skin),
            {bus: link.send for bus, link in links.items()},
            time.monotonic(),
            rest_s=rest_s,
            stroke_s=stroke_s,
            say=lambda line: say("node check", line),
        )
        while not reading.done:
            if stop.is_set():
                reading.stop()
            select.select([*links.values()], [], [], min(TURN_S, max(0.0, reading.due_s - time.monotonic())) or TURN_S)
            for bus, link in links.items():
                reading.take(bus, link.receive(), time.monotonic())
            reading.tick(time.monotonic())
    return reading


def _show_wiring(skin: Layout, findings: "list[Finding]", out: Path | None, *, as_json: bool) -> int:
    """Print what is not wired as the layout says, and write the corrected file."""
    from commissioning.wiring_check import chains_file, corrected_order, text_of

    if as_json:
        print_json([{**dataclasses.asdict(each), "text": text_of(each)} for each in findings])
    else:
        for each in findings:
            print(text_of(each))
        print(f"{skin.name}: {f'{len(findings)} findings' if findings else 'is wired as the layout says'}")
    if out is not None:
        write_file(out, chains_file(skin.phi(), corrected_order(skin.phi(), findings)))
    return int(bool(findings))


def _bus_number(skin: Layout, name: str | None) -> int:
    names = [bus.name for bus in skin.bus]
    if name is None and len(names) == 1:
        return 0
    if name not in names:
        got = "none" if name is None else f"'{name}'"
        raise InputError(f"expected --bus with one of {', '.join(names)}, got {got}")
    return names.index(name)


class _Talk(Talk, Protocol):
    """A talk with a node: a check, or transfers; `give_up` has it put back what it wrote, and end."""

    def give_up(self, now_s: float) -> None: ...


def _run(check: _Talk, link: Link, stop: StopSignal) -> None:
    is_stopped = False
    while not check.done:
        if stop.is_set() and not is_stopped:
            is_stopped = True
            check.give_up(time.monotonic())
        else:
            take_turn({0: link}, {0: check})
    if is_stopped:
        raise RunError("stopped before the talk with the node was over")


def _show(report: NodeReport) -> None:
    """Print what was compared, and a line for each difference."""
    place = f"{report.bus}, node {report.node_id}"
    for text in report.differences:
        print(f"{place}: {text}")
    for text in report.notes:
        print(f"{place}: note: {text}")
    count = len(report.differences)
    verdict = f"{count} difference{'s' * (count != 1)}" if count else "keeps the contract"
    compared = f"{report.objects} objects, {report.frames} TPDOs"
    late = f" of {report.cycles} cycles, the last {1e3 * report.latest_s:.1f} ms after SYNC" if report.cycles else ""
    print(f"{place}: {verdict} ({compared}{late})")
