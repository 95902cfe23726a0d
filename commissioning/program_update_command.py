"""``skin node update``: a program into boards, of several buses at the same time."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from bus.options import BusOptions, closing_links, open_links
from canskin.errors import InputError, RunError
from commissioning.node_options import NodeOptions
from commissioning.program_update import ProgramUpdate
from commissioning.talk import take_turn
from dbc.contract import Contract
from dbc.program import Program
from shell.service import StopSignal, say
from shell.terminal import Json, print_json, print_table
from skin.layout import Layout


def update(
    program: Path,
    *,
    of: NodeOptions | None = None,
    can: BusOptions | None = None,
    every: Annotated[bool, Parameter(name="--all", negative=())] = False,
    json: Json = False,
) -> int:
    """Load a program into a board, or into each board that does not run it, and start it.

    It may run beside the gateway. A board whose download was cut keeps its old program. Ends with 1 unless each board
    runs the program.

    Parameters
    ----------
    program
        File of ``skin contract --program``.
    every
        All boards, of ``--bus`` or of the skin.
    json
        Print one JSON object.

    Examples
    --------
    skin node update palm-1.1.bin --bus bus0 --node 3 -i socketcan -c can0
    skin node update palm-1.1.bin --all -i socketcan -c can0
    """
    of = of or NodeOptions()
    if every == (of.node is not None):
        raise InputError("expected 'skin node update PROGRAM' with --node for one board, or with --all")
    skin, loaded = of.load(), Program.read(program)
    buses = range(len(skin.bus)) if every and of.bus is None else [of.bus_number(skin)]
    device = loaded.vendor_id, loaded.product_code
    if device != (skin.device.vendor_id, skin.device.product_code):
        wanted = f"vendor-ID {skin.device.vendor_id:X}h and product code {skin.device.product_code:X}h of {skin.name}"
        raise InputError(f"{program}: expected a program for {wanted}, got {device[0]:X}h and {device[1]:X}h")
    if of.node is not None:
        of.board(Contract.from_layout(skin))

    def tell(bus: int) -> Callable[[int, str], None]:
        return lambda node, text: say("node update", f"{skin.bus[bus].name} node {node}: {text}")

    stop = StopSignal().install()
    with closing_links(open_links(skin, can or BusOptions(), buses, name="node update", stop=stop)) as links:
        updates = {
            bus: ProgramUpdate(
                loaded,
                skin.bus[bus].ids if of.node is None else [of.node],
                link.send,
                time.monotonic(),
                say=tell(bus),
            )
            for bus, link in links.items()
        }
        while not all(each.done for each in updates.values()) and not stop.is_set():
            take_turn(links, updates)
        for each in updates.values():
            each.give_up()
    _show(skin, loaded, updates, as_json=json)
    if stop.is_set():
        raise RunError("stopped: boards keep their old programs; 'skin node update' again completes it")
    return int(any(each.failed for each in updates.values()))


def _show(skin: Layout, program: Program, updates: dict[int, ProgramUpdate], *, as_json: bool) -> None:
    """Print what became of each board."""
    rows = [
        (skin.bus[bus].name, node, each) for bus, update in updates.items() for node, each in update.outcomes.items()
    ]
    wanted = program.identification
    if as_json:
        boards = [
            {"bus": bus, "node": node, "before": each.before, "after": each.after, "result": each.result}
            for bus, node, each in rows
        ]
        print_json({"program": wanted, "version": program.version, "boards": boards})
        return
    texts = [[bus, str(node), _text(each.before), _text(each.after), each.result] for bus, node, each in rows]
    print_table(["bus", "node", "before", "now", "result"], texts)
    running = sum(each.after == wanted for *_, each in rows)
    print(f"{running} of {len(rows)} boards run version {program.version} ({wanted:08X}h)")


def _text(identification: int | None) -> str:
    return "unknown" if identification is None else f"{identification:08X}h"
