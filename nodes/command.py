"""``skin nodes``: the virtual nodes of a skin."""

import math
from contextlib import ExitStack, nullcontext
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from bus.options import BusOptions, channels, closing_links, open_links, serve_buses
from canskin.errors import InputError
from canskin.session import DEFAULT_ENDPOINT
from dbc.choice import choose_nodes
from dbc.contract import Contract
from nodes.firmware.library import Firmware
from nodes.sending import sending_of
from nodes.service import NodesService, wait_on_sockets
from shell.pulse import Pulse
from shell.service import StopSignal, say
from shell.skin_options import join
from shell.touch_options import NO_TOUCH_OPTIONS, TouchOptions
from skin.layout import load_layout
from skin.taxel import NOISE_N


def nodes(
    *,
    layout: Path | None = None,
    bus: BusOptions | None = None,
    connect: str = DEFAULT_ENDPOINT,
    fabric: bool = True,
    only: Annotated[list[str] | None, Parameter(negative=(), consume_multiple=True)] = None,
    without: Annotated[list[str] | None, Parameter(negative=(), consume_multiple=True)] = None,
    touch: TouchOptions = NO_TOUCH_OPTIONS,
    rest: float = 0.0,
    noise_n: float = NOISE_N,
    store: Path | None = None,
    unnumbered: Annotated[bool, Parameter(negative=())] = False,
    firmware: Annotated[bool, Parameter(negative=())] = False,
) -> None:
    """Run the virtual CANopen nodes of a skin.

    Virtual buses that no ``skin bus`` serves are served by the nodes, as long as they run.

    Parameters
    ----------
    layout
        TOML of the skin; without it the default skin of 128 nodes on four buses.
    bus
        CAN interface and channels.
    connect
        Endpoint of the fabric's hub.
    fabric
        ``--no-fabric`` uses the bus only; the true forces are then not published.
    only
        Run only these nodes, as BUS:NODE or BUS:FIRST-LAST, for example bus0:5 or bus2:1-16.
    without
        Run all nodes except these.
    touch
        What touches the skin.
    rest
        Seconds without touch before the first object.
    noise_n
        Standard deviation of the sensor noise in newtons. Recordings get none: they contain their own noise.
    store
        Folder for the parameters that 1010h stores, one file per node, like the flash memory of a board. With
        `firmware` loaded programs are kept, too.
    unnumbered
        Boards begin without node-IDs, unless `store` has them, and wait for ``skin commission``.
    firmware
        Run the C firmware of the boards (``skin contract --firmware``) in place of nodes in Python. The system's C
        compiler (cc) compiles the firmware once.

    Examples
    --------
    skin nodes --objects golf-ball
    skin nodes --defect dead=0.02 cross-talk drift
    skin nodes --drift patch12:ramp:0.003:10:60 whole:step:-0.002:5
    skin nodes -i socketcan -c vcan0 --only bus0:1-16
    skin nodes --unnumbered --store flash
    """
    if not 0 <= noise_n < math.inf:
        raise InputError(f"--noise-n: expected 0 or more, got {noise_n:g}")
    touch.check()
    if touch.input is not None and rest:
        raise InputError("--rest is for objects: a recording begins as it begins")
    if store is not None:
        try:
            store.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"--store {store}: expected a folder that can be written: {error.strerror}") from error
    stop = StopSignal().install()
    pulse = Pulse(stop)
    skin = load_layout(layout)
    analogue = {"noise_n": noise_n, "seed": touch.seed, "defects": touch.defects(skin)}
    contract = Contract.from_layout(skin)
    chosen = choose_nodes(contract, only or [], without or [])
    mine = [node for node in contract.nodes if node.node_id in chosen.get(node.bus, ())]
    compiled = None
    if firmware:
        compiled = Firmware(contract, mine, store=store, unnumbered=unnumbered)
    blocks = [node.block for node in mine]
    hardware = sending_of(skin).hardware(contract, blocks, touch.source(skin, rest), compiled, **analogue)
    options = bus or BusOptions()
    with ExitStack() as last:
        server = serve_buses(skin, options)
        if server is None:
            links = open_links(skin, options, chosen, name="nodes", stop=stop)
        else:
            last.enter_context(server)
            names = channels(skin, options)
            links = {number: server.join(names[number], "nodes") for number in chosen}
        last.enter_context(closing_links(links))
        with nullcontext() if server is None else server.beside():  # the gateway, which may be the hub, waits for a bus
            joined = pulse.fabric = join(skin, "nodes", connect, stop=pulse) if fabric else None
        if joined is not None:
            last.callback(joined.close)
        wait = wait_on_sockets if server is None else server.ready
        service = NodesService(
            contract, links, chosen, hardware, joined, store=store, unnumbered=unnumbered, firmware=compiled, wait=wait
        )
        count = sum(map(len, chosen.values()))
        served = "" if server is None else ", which this process serves"
        say("nodes", f"{count} node{'s' * (count != 1)} on {len(links)} bus{'es' * (len(links) != 1)}{served}")
        service.run(stop, pulse.beat)
