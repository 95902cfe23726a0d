"""``skin node reset``, ``stop`` and ``start``: an NMT command to one node or all nodes of a bus."""

import time
from contextlib import closing

from bus.options import BusOptions, open_links
from commissioning.node_options import NodeOptions, lead
from commissioning.node_orders import NodeOrder
from dbc.canopen import NmtCommand, state_text
from shell.service import StopSignal
from shell.terminal import Json, print_json, print_table


def reset(*, of: NodeOptions | None = None, can: BusOptions | None = None, json: Json = False) -> int:
    """Reset one node, or all nodes of a bus.

    Ends with 1 unless each node tells the new state within 3 s. A running gateway starts nodes of the layout again.

    Parameters
    ----------
    json
        Print one JSON object.

    Examples
    --------
    skin node reset --bus bus0 -i socketcan -c can0
    skin node reset --bus bus0 --node 3
    """
    return _order(NmtCommand.RESET_NODE, of or NodeOptions(), can or BusOptions(), as_json=json)


def stop(*, of: NodeOptions | None = None, can: BusOptions | None = None, json: Json = False) -> int:
    """Stop one node, or all nodes of a bus.

    Parameters
    ----------
    json
        Print one JSON object.

    Examples
    --------
    skin node stop --bus bus0 -i socketcan -c can0
    skin node stop --bus bus0 --node 3
    """
    return _order(NmtCommand.STOP, of or NodeOptions(), can or BusOptions(), as_json=json)


def start(*, of: NodeOptions | None = None, can: BusOptions | None = None, json: Json = False) -> int:
    """Start one node, or all nodes of a bus.

    Parameters
    ----------
    json
        Print one JSON object.

    Examples
    --------
    skin node start --bus bus0 -i socketcan -c can0
    skin node start --bus bus0 --node 3
    """
    return _order(NmtCommand.START, of or NodeOptions(), can or BusOptions(), as_json=json)


def _order(command: NmtCommand, of: NodeOptions, can: BusOptions, *, as_json: bool) -> int:
    """Send an NMT command, and show which state the nodes tell."""
    skin = of.load()
    number = of.bus_number(skin)
    awaited = skin.bus[number].ids if of.node is None else [of.node]
    stopping = StopSignal().install()
    with closing(open_links(skin, can, [number], name="node", stop=stopping)[number]) as link:
        order = NodeOrder(command, of.node or 0, awaited, link.send, time.monotonic())
        lead(order, link, stopping)
    told = {each: None if state is None else state_text(state) for each, state in order.states.items()}
    if as_json:
        print_json({"bus": skin.bus[number].name, "states": told, "missing": order.missing})
    else:
        print_table(["node", "state"], [[str(each), state or "silent"] for each, state in told.items()])
    return int(bool(order.missing))
