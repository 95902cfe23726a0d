"""``skin export``: sources for the boards of a skin."""

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from dbc.choice import choose_nodes
from dbc.contract import Contract
from dbc.generate import write_files
from firmware.export import export_files
from skin.layout import load_layout, require_one_state
from skin.terminal import Json, print_json


def export(
    what: Literal["firmware"],  # noqa: ARG001 - the only thing to export so far
    *,
    layout: Path | None = None,
    out: Path,
    node: Annotated[list[str] | None, Parameter(negative=(), consume_multiple=True)] = None,
    json: Json = False,
) -> None:
    """Write C99 sources for the boards of a skin, without heap: sums, packing, object dictionary, a CANopen slave.

    Prints the path of every file. ``README.md`` among them says what to do with the others.

    Parameters
    ----------
    what
        firmware
    layout
        TOML of the skin; without it the default skin.
    out
        Folder for the files.
    node
        Write the constants of these nodes, as BUS:NODE or BUS:FIRST-LAST; default: all nodes.
    json
        Print one JSON list.

    Examples
    --------
    skin export firmware --out firmware
    skin export firmware --layout palm.toml --node bus0:5 --out palm-firmware
    """
    skin = load_layout(layout)
    require_one_state(skin, "the firmware in C")
    contract = Contract.from_layout(skin)
    chosen = choose_nodes(contract, node or [], [])
    nodes = [each for each in contract.nodes if each.node_id in chosen.get(each.bus, ())]
    paths = [str(path) for path in write_files(export_files(contract, nodes), out)]
    if json:
        print_json(paths)
    else:
        print("\n".join(paths))
