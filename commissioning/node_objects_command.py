"""``skin node get``, ``set`` and ``objects``: objects of a device by name."""

import time
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

from bus.options import BusOptions, open_channels, open_links
from canskin.errors import InputError
from commissioning.node_objects import Entry, NodeTransfers, entries_of_file, entries_of_node, find, parse_writes
from commissioning.node_options import NodeOptions, lead
from dbc.canopen import HIGHEST_NODE_ID
from dbc.contract import Contract
from shell.service import StopSignal
from shell.terminal import Json, print_json, print_table
from skin.layout import Layout
from skin.ranges import listed


def objects(*parts: str, of: NodeOptions | None = None, eds: Path | None = None, json: Json = False) -> int:
    """List the objects of a device, by default those of the first board; no bus is needed.

    Parameters
    ----------
    parts
        Parts of names: objects with all of them are listed.
    eds
        EDS of a device that is no board of the layout.
    json
        Print one JSON object.

    Examples
    --------
    skin node objects heartbeat
    skin node objects --eds drive.eds --node 5
    """
    of = of or NodeOptions()
    skin = of.load()
    if of.node is None:
        of = replace(of, bus=of.bus or skin.bus[0].name)
        of = replace(of, node=skin.bus[of.bus_number(skin)].ids[0])
    known = _known(skin, of, eds)
    found = [each for each in known if all(part.lower() in each.name.lower() for part in parts)]
    if not found:
        raise InputError(f"no object has {' and '.join(parts)} in its name: name less of it")
    _show(found, {}, as_json=json)
    return 0


def get(
    *names: str,
    of: NodeOptions | None = None,
    can: BusOptions | None = None,
    eds: Path | None = None,
    json: Json = False,
) -> int:
    """Read objects of a device by SDO, also beside the gateway, which gives way.

    Parameters
    ----------
    names
        Names, or index:sub.
    eds
        EDS of a device that is no board of the layout. Without ``--bus`` the single channel is that of the device.
    json
        Print one JSON object.

    Examples
    --------
    skin node get "Producer heartbeat time" 1018h:4 --bus bus0 --node 3
    skin node get 6041h --eds drive.eds --node 5 -i socketcan -c can0
    """
    return _transfer("get", names, of or NodeOptions(), can or BusOptions(), eds, as_json=json)


def set_(
    *writes: str,
    of: NodeOptions | None = None,
    can: BusOptions | None = None,
    eds: Path | None = None,
    json: Json = False,
) -> int:
    """Write objects of a device by SDO, and read them again, also beside the gateway, which gives way.

    After a write to an object that the layout fixes, the gateway proves the node again, and writes the layout's value
    (``configure = "write"``).

    Parameters
    ----------
    writes
        OBJECT=VALUE, where OBJECT is a name or index:sub.
    eds
        EDS of a device that is no board of the layout. Without ``--bus`` the single channel is that of the device.
    json
        Print one JSON object.

    Examples
    --------
    skin node set 1010h:1=0x65766173 --bus bus0 --node 3
    skin node set 6060h=3 --eds drive.eds --node 5 -i socketcan -c can0
    """
    return _transfer("set", writes, of or NodeOptions(), can or BusOptions(), eds, as_json=json)


def _known(skin: Layout, of: NodeOptions, eds: Path | None) -> list[Entry]:
    """Return the objects of a device: of its EDS, or of a board of the skin."""
    if of.node is None:
        raise InputError(f"expected --node with a node-ID from 1 to {HIGHEST_NODE_ID}, got none")
    if eds is not None:
        return entries_of_file(eds, of.node)
    contract = Contract.from_layout(skin)
    return entries_of_node(contract, of.board(contract))


def _transfer(
    verb: str, texts: Sequence[str], of: NodeOptions, can: BusOptions, eds: Path | None, *, as_json: bool
) -> int:
    if not texts:
        raise InputError(f"expected 'skin node {verb}' with objects, by name or index:sub; 'objects' lists them")
    skin = of.load()
    known = _known(skin, of, eds)
    # A channel that is named needs no bus of the layout, if the device is none of the layout's.
    is_other = eds is not None and of.bus is None and len(can.channel) == 1
    number = 0 if is_other else of.bus_number(skin)
    writes = parse_writes(known, texts) if verb == "set" else []
    reads = [entry for entry, _ in writes] or [each for text in listed(texts) for each in find(known, text)]
    stop, name = StopSignal().install(), f"node {verb}"
    if is_other:
        (link,) = open_channels(can, skin.bus[0].bitrate, skin.bus[0].data_bitrate, name=name).values()
    else:
        link = open_links(skin, can, [number], name=name, stop=stop)[number]
    with closing(link):
        transfers = NodeTransfers(of.node or 0, list(dict.fromkeys(reads)), link.send, time.monotonic(), writes)
        lead(transfers, link, stop)
    _show(list(transfers.values), transfers.values, as_json=as_json)
    return int(any(isinstance(each, str) for each in transfers.values.values()))


def _show(entries: list[Entry], values: dict[Entry, bytes | str], *, as_json: bool) -> None:
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
