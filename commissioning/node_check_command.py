"""``skin node check``: a board against the contract, or the wiring of the skin against the layout."""

import dataclasses
import select
import time
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

from bus.options import BusOptions, closing_links, open_links
from canskin.errors import InputError
from commissioning.node_check import NodeCheck
from commissioning.node_frames import NodeReport
from commissioning.node_options import NodeOptions, lead
from commissioning.talk import TURN_S
from dbc.contract import Contract
from shell.output import check_output_path, write_file
from shell.service import StopSignal, say
from shell.terminal import Json, print_json
from skin.layout import Layout, require_boards
from skin.ranges import require_above_zero, require_number

if TYPE_CHECKING:
    from commissioning.count_reading import CountReading
    from commissioning.wiring_findings import Finding

_NAME = "node check"


def check(
    *,
    of: NodeOptions | None = None,
    can: BusOptions | None = None,
    live: float | None = None,
    path: Path | None = None,
    rest: float = 1.0,
    out: Path | None = None,
    json: Json = False,
) -> int:
    """Compare a board with the contract, or the wiring of the skin with the layout.

    Compares the objects of a board, and the frames that it sends while it shows test patterns, and offsets in place of
    its taxels. It needs a bus without gateway. The board is left pre-operational, with the test patterns, gains and
    offsets that it had. Ends with 1 if the board differs from the contract.

    With ``--live`` the wiring is checked in place of a board: which taxels are not wired as the layout says, and which
    boards are exchanged.

    Parameters
    ----------
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
    """
    of, can = of or NodeOptions(), can or BusOptions()
    skin = of.load()
    if live is not None:
        if (of.node or of.bus) is not None:
            raise InputError("expected --node and --bus of a board, or --live of the whole skin, got both")
        require_above_zero("--live", live)
        require_number("--rest", rest)
        return _check_wiring(skin, can, live, rest, path=path, out=out, as_json=json)
    if (path or out) is not None:
        raise InputError("expected --path and --out with --live alone")
    if of.node is None:
        raise InputError("expected --node with the node-ID of a board, or --live")
    contract, stop = Contract.from_layout(skin), StopSignal().install()
    board = of.board(contract)
    with closing(open_links(skin, can, [board.bus], name=_NAME, stop=stop)[board.bus]) as link:
        run = NodeCheck(contract, board, link.send, time.monotonic())
        lead(run, link, stop)
    if json:
        print_json(dataclasses.asdict(run.report))
    else:
        show(run.report)
    return int(bool(run.report.differences))


def show(report: NodeReport) -> None:
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


def _check_wiring(
    skin: Layout,
    can: BusOptions,
    stroke_s: float,
    rest_s: float,
    *,
    path: Path | None,
    out: Path | None,
    as_json: bool,
) -> int:
    """Print what is not wired as the layout says, and write the corrected file."""
    from commissioning.wiring_check import chains_file, check_counts, corrected_order, finger_path, text_of

    finger = None if path is None else finger_path(path)  # before a person strokes the skin
    if out is not None:
        check_output_path(out, "wiring", ".csv")
    findings: list[Finding] = check_counts(skin, _read_counts(skin, can, stroke_s, rest_s), finger)
    if as_json:
        print_json([{**dataclasses.asdict(each), "text": text_of(each)} for each in findings])
    else:
        for each in findings:
            print(text_of(each))
        print(f"{skin.name}: {f'{len(findings)} findings' if findings else 'is wired as the layout says'}")
    if out is not None:
        write_file(out, chains_file(skin.phi(), corrected_order(skin.phi(), findings)))
    return int(bool(findings))


def _read_counts(skin: Layout, can: BusOptions, stroke_s: float, rest_s: float) -> "CountReading":
    """Read the counts of all boards while somebody strokes the skin."""
    from commissioning.count_reading import CountReading

    require_boards(skin)
    if skin.taxels.is_analogue:
        raise InputError("analogue boards have no counts of taxels: their wiring cannot be checked")
    stop = StopSignal().install()
    with closing_links(open_links(skin, can, name=_NAME, stop=stop)) as links:
        say(_NAME, f"leave the skin alone for {rest_s:g} s")
        reading = CountReading(
            Contract.from_layout(skin),
            {bus: link.send for bus, link in links.items()},
            time.monotonic(),
            rest_s=rest_s,
            stroke_s=stroke_s,
            say=lambda line: say(_NAME, line),
        )
        while not reading.done:
            if stop.is_set():
                reading.stop()
            select.select([*links.values()], [], [], min(TURN_S, max(0.0, reading.due_s - time.monotonic())) or TURN_S)
            for bus, link in links.items():
                reading.take(bus, link.receive(), time.monotonic())
            reading.tick(time.monotonic())
    return reading
