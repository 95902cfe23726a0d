"""``skin scan``: lists what is on a bus."""

import dataclasses
import time
from typing import Annotated, Any

from cyclopts import Parameter

from bus.link import Link
from bus.options import BusOptions, check_bit_rates, closing_links, open_channels, open_links
from canskin.errors import InputError, RunError
from commissioning.scan import Scan
from commissioning.talk import take_turn
from dbc.canopen import identifier_text
from shell.service import StopSignal, say
from shell.skin_options import SkinOptions, told_skins
from shell.terminal import Json, print_json, print_table
from skin.layout import BITRATE_MAX
from skin.ranges import require_above_zero


def scan(
    *,
    of: SkinOptions | None = None,
    can: BusOptions | None = None,
    bitrate: int | None = None,
    data_bitrate: int | None = None,
    seconds: float = 2.0,
    listen: Annotated[bool, Parameter(negative=())] = False,
    json: Json = False,
) -> int:
    """List what is on a CAN bus: identifiers with their rates, CANopen nodes with state and identity, SYNC.

    Listens, then asks every node-ID for its identity by SDO (1000h, 1018h, 1005h, 1008h), which takes 5 % of the bus at
    most. A node that other masters ask all the time is listed as busy. Ctrl-C ends the scan and shows what is known.
    Exit code 1: two nodes whose 1005h says that they produce SYNC; a gateway has no 1005h.

    Parameters
    ----------
    of
        The skin whose buses are scanned, with their bit rates. Without an option, the channels of ``-c``; without those
        the buses of the skin on the hub of this machine.
    can
        CAN interface and channels.
    bitrate
        Without a layout: bit rate of the channels, bit/s, by default 1000000. SocketCAN has its own.
    data_bitrate
        Without a layout: data bit rate, which makes the channels CAN FD. SocketCAN knows by itself.
    seconds
        Time of listening.
    listen
        Only listen: send nothing.
    json
        Print one JSON object.

    Examples
    --------
    skin scan -i socketcan -c can0
    skin scan -i socketcan -c can0 can1 --listen --seconds 10
    skin scan -c bus0 --json
    """
    require_above_zero("--seconds", seconds)
    options, stop = can or BusOptions(), StopSignal().install()
    if of is not None or not options.channel:
        if (bitrate or data_bitrate) is not None:
            raise InputError("expected a skin or --bitrate and --data-bitrate, got both: a layout has the rates")
        of = of or SkinOptions()
        if of == SkinOptions() and not told_skins(of.endpoint):
            raise InputError("expected -c with the channels of the buses, or --layout: no gateway is there")
        skin = of.find(needs_hub=False)
        lines = skin.bus
        links = {lines[number].name: link for number, link in open_links(skin, options, sends=not listen).items()}
        rates = {line.name: line.bitrate for line in lines}
    else:
        bitrate = BITRATE_MAX if bitrate is None else bitrate
        check_bit_rates(bitrate, data_bitrate)
        links = open_channels(options, bitrate, data_bitrate, name="scan", sends=not listen)
        rates = dict.fromkeys(links, bitrate)
    with closing_links(links):
        say("scan", f"listening for {seconds:g} s")
        for link in links.values():
            link.receive()  # what came while later links were opened
        now_s = time.monotonic()
        scans = {
            name: Scan(link.send, rates[name], now_s, listen_s=seconds, asks=not listen) for name, link in links.items()
        }
        _run(links, scans, stop)
    found = [_about(name, each) for name, each in scans.items()]
    if json:
        print_json(found)
    else:
        for each in found:
            _show(each)
    if not any(each["identifiers"] or each["nodes"] for each in found):
        raise RunError(f"nothing was heard on {', '.join(links)}: are devices powered, and the bit rates equal?")
    return int(any(len(each["sync_producers"]) > 1 for each in found))


def _run(links: dict[str, Link], scans: dict[str, Scan], stop: StopSignal) -> None:
    while not all(each.done for each in scans.values()):
        if stop.is_set():
            say("scan", "stopped before the scan was done: what was heard until now")
            for each in scans.values():
                each.stop(time.monotonic())
            return
        take_turn(links, scans)


def _about(name: str, scanned: Scan) -> dict[str, Any]:
    nodes = [each for _, each in sorted(scanned.nodes.items())]
    return {
        "bus": name,
        "sync_rate_hz": scanned.sync_rate_hz,
        "sync_producers": [each.node_id for each in nodes if each.produces_sync],
        "nodes": [dataclasses.asdict(each) for each in nodes],
        "identifiers": [{**dataclasses.asdict(each), "meaning": each.meaning} for each in scanned.identifiers],
    }


def _why_unknown(node: dict[str, Any]) -> str:
    if node["is_busy"]:
        return "busy: another master asks it"
    return node["refusal"] if node["device_type"] is None and node["refusal"] else "-"


def _show(found: dict[str, Any]) -> None:
    rows = [
        [
            each["node_id"],
            each["state"] or "-",
            *(_hex(each[key]) for key in ("device_type", "vendor_id", "product_code", "revision")),
            "-" if each["serial_number"] is None else each["serial_number"],
            each["device_name"] or _why_unknown(each),
            ", ".join(each["heard"]),
        ]
        for each in found["nodes"]
    ]
    headings = ["node", "state", "type", "vendor", "product", "revision", "serial", "name", "heard"]
    print_table(headings, rows, title=found["bus"])
    print()
    table = [
        [
            identifier_text(each["cob_id"], is_extended=each["is_extended"]),
            each["meaning"],
            each["frames"],
            f"{each['rate_hz']:.2f}",
            each["length"],
        ]
        for each in found["identifiers"]
    ]
    print_table(["COB-ID", "usual meaning", "frames", "a second", "bytes"], table)
    producers = found["sync_producers"]
    who = f", nodes that produce SYNC (1005h): {', '.join(map(str, producers))}" if producers else ""
    sync = f"SYNC {found['sync_rate_hz']:.2f} times a second" if found["sync_rate_hz"] else "no SYNC"
    print(f"{found['bus']}: {sync}{who}")
    if len(producers) > 1:
        print(f"{found['bus']}: a bus has one SYNC producer: clear bit 30 of 1005h in the others")
    elif producers and found["sync_rate_hz"]:
        print(
            f"{found['bus']}: if a gateway runs there, both produce SYNC: clear bit 30 of 1005h in node {producers[0]}"
        )


def _hex(value: int | None) -> str:
    return "-" if value is None else f"{value:X}h"
