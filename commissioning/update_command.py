"""``skin node update``: a program into boards, of several buses at the same time."""

import time
from collections.abc import Callable, Sequence
from pathlib import Path

from bus.options import BusOptions, closing_links, open_links
from canskin.errors import InputError, RunError
from commissioning.program_update import ProgramUpdate
from commissioning.talk import take_turn
from dbc.program import Program
from shell.service import StopSignal, say
from shell.terminal import print_json, print_table
from skin.layout import Layout
from skin.ranges import ranges_text


def update_nodes(
    skin: Layout,
    names: Sequence[str],
    buses: Sequence[int],
    node_id: int | None,
    can: BusOptions,
    *,
    every: bool,
    as_json: bool,
) -> int:
    """Load a program into one board or all boards of `buses`, and print what became of each.

    Returns 1 if a board does not run the program, else 0.
    """
    if len(names) != 1 or every == (node_id is not None):
        raise InputError("expected 'skin node update PROGRAM' with --node for one board, or with --all")
    program = Program.read(Path(names[0]))
    device = program.vendor_id, program.product_code
    if device != (skin.device.vendor_id, skin.device.product_code):
        wanted = f"vendor-ID {skin.device.vendor_id:X}h and product code {skin.device.product_code:X}h of {skin.name}"
        raise InputError(f"{names[0]}: expected a program for {wanted}, got {device[0]:X}h and {device[1]:X}h")
    if node_id is not None and node_id not in skin.bus[buses[0]].ids:
        line = skin.bus[buses[0]]
        raise InputError(f"expected a node-ID of {line.name}, {ranges_text(line.ids)}, got {node_id}")

    def tell(bus: int) -> Callable[[int, str], None]:
        return lambda node, text: say("node update", f"{skin.bus[bus].name} node {node}: {text}")

    stop = StopSignal().install()
    with closing_links(open_links(skin, can, buses, name="node update", stop=stop)) as links:
        updates = {
            bus: ProgramUpdate(
                program,
                skin.bus[bus].ids if node_id is None else [node_id],
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
    _show(skin, program, updates, as_json=as_json)
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
