"""``skin node check``: compares a board with the contract, or the wiring with the layout."""

import dataclasses
import select
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Literal

from cyclopts import Parameter

from bus.link import Link
from bus.options import BusOptions, open_links
from canskin.errors import InputError, RunError
from dbc.contract import Contract
from gateway.node_check import NodeCheck, NodeReport
from shell.output import write_file
from shell.service import StopSignal, say
from shell.terminal import Json, print_json
from skin.layout import Layout, load_layout, require_boards, require_one_state
from skin.ranges import ranges_text

if TYPE_CHECKING:
    from gateway.count_reading import CountReading
    from gateway.wiring import Finding

#: Longest wait for frames in one turn.
TURN_S: Final = 0.01


def node(
    action: Literal["check"],
    *,
    node_id: Annotated[int | None, Parameter(name="--node")] = None,
    bus: str | None = None,
    layout: Path | None = None,
    can: BusOptions | None = None,
    wiring: Path | None = None,
    live: float | None = None,
    path: Path | None = None,
    rest: float = 1.0,
    out: Path | None = None,
    json: Json = False,
) -> int:
    """Check a board: its objects, and the bytes that it sends while it shows each test pattern.

    Needs a bus without gateway. The board is left pre-operational, with the test patterns that it had. Ends with 1 if
    the board differs from the contract. Of adaptive boards the objects alone are compared.

    With ``--wiring`` or ``--live`` the wiring is checked in place of a board: which taxels are not wired as the layout
    says, and which boards are exchanged.

    Parameters
    ----------
    action
        ``check``.
    node_id
        Node-ID of the board.
    bus
        Name of its bus in the layout. Default: the only one.
    layout
        TOML of the skin; without it the default skin.
    can
        CAN interface and channels; a single channel is that of the bus.
    wiring
        Recording (``skin record``) of one finger that goes over the whole skin, after a time without touch.
    live
        Seconds in which one finger goes over the whole skin, after `rest`: the counts of all taxels are read from all
        boards. Ctrl-C ends the stroke.
    path
        CSV with the columns time_s, x_m, y_m, z_m: where the finger is after the first measurement or reading.
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
    skin node check --layout palm.toml --wiring stroke.mcap --path finger.csv --out boards.csv
    skin node check --layout palm.toml --live 30 -i socketcan -c can0
    """
    if action != "check":
        raise InputError(f"expected 'skin node check', got '{action}'")
    skin = load_layout(layout)
    if wiring is not None:
        from gateway.wiring_check import check_wiring

        require_boards(skin)
        return _show_wiring(skin, check_wiring(skin, wiring, path, rest), out, as_json=json)
    stop = StopSignal().install()
    if live is not None:
        from gateway.wiring_check import check_counts

        reading = _read_live(skin, can or BusOptions(), live, rest, stop)
        return _show_wiring(skin, check_counts(skin, reading, path), out, as_json=json)
    if node_id is None:
        raise InputError("expected --node with the node-ID of a board, --wiring with a recording, or --live")
    require_one_state(skin, "'skin node check'")
    number = _bus_number(skin, bus)
    contract = Contract.from_layout(skin)
    wanted = [each for each in contract.on_bus(number) if each.node_id == node_id]
    if not wanted:
        raise InputError(
            f"expected a node-ID of {skin.bus[number].name}, {ranges_text(skin.bus[number].ids)}, got {node_id}"
        )
    options = can or BusOptions()
    if len(options.channel) == 1:
        options = dataclasses.replace(options, channel=options.channel * len(skin.bus))
    link = open_links(skin, options, [number], name="node check", stop=stop)[number]
    try:
        check = NodeCheck(contract, wanted[0], link.send, time.monotonic())
        _run(check, link, stop)
    finally:
        link.close()
    if json:
        print_json(dataclasses.asdict(check.report))
    else:
        _show(check.report)
    return int(bool(check.report.differences))


def _read_live(skin: Layout, can: BusOptions, stroke_s: float, rest_s: float, stop: StopSignal) -> "CountReading":
    """Read the counts of all boards while somebody strokes the skin."""
    from gateway.count_reading import CountReading

    require_boards(skin)
    if skin.taxels.is_analogue:
        raise InputError("analogue boards have no counts of taxels: check a recording of sums, --wiring")
    links = open_links(skin, can, name="node check", stop=stop)
    try:
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
    finally:
        for link in links.values():
            link.close()
    return reading


def _show_wiring(skin: Layout, findings: "list[Finding]", out: Path | None, *, as_json: bool) -> int:
    """Print what is not wired as the layout says, and write the corrected file."""
    from gateway.wiring_check import chains_file, corrected_order, text_of

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


def _run(check: NodeCheck, link: Link, stop: StopSignal) -> None:
    try:
        while not check.done:
            if stop.is_set():
                raise RunError("stopped before the board was checked")
            timeout_s = min(TURN_S, max(0.0, check.due_s - time.monotonic()))
            select.select([link], [], [], timeout_s or TURN_S)
            check.take(link.receive(), time.monotonic())
            check.tick(time.monotonic())
    finally:
        if not check.done:
            check.give_up()


def _show(report: NodeReport) -> None:
    """Print what was compared, and a line for each difference."""
    place = f"{report.bus}, node {report.node_id}"
    for text in report.differences:
        print(f"{place}: {text}")
    for text in report.notes:
        print(f"{place}: note: {text}")
    count = len(report.differences)
    verdict = f"{count} difference{'s' * (count != 1)}" if count else "keeps the contract"
    compared = f"{report.objects} objects, {report.frames} TPDOs of {report.cycles} cycles"
    late = f", the last {1e3 * report.latest_s:.1f} ms after SYNC" if report.frames else ""
    print(f"{place}: {verdict} ({compared}{late})")
