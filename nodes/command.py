"""``skin nodes``: the virtual nodes of a skin."""

import math
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from bus.options import BusOptions, open_links
from canskin.errors import InputError
from canskin.fabric import Fabric
from canskin.session import DEFAULT_ENDPOINT
from dbc.choice import choose_nodes
from dbc.contract import Contract
from firmware.library import Firmware
from nodes.service import NodesService
from nodes.ways import new_hardware
from skin.defects import parse_defects
from skin.layout import Layout, load_layout, require_one_state
from skin.recording_options import ArrayNames, FrameRate, FullScale, check_touch_options, load_recording
from skin.service import StopSignal, say
from skin.sources import StrokeKind, TaxelSource, load_objects, object_names
from skin.taxel import NOISE_N
from skin.zero_drift import parse_drifts


def nodes(
    *,
    layout: Path | None = None,
    bus: BusOptions | None = None,
    connect: str = DEFAULT_ENDPOINT,
    fabric: bool = True,
    only: Annotated[list[str] | None, Parameter(negative=(), consume_multiple=True)] = None,
    without: Annotated[list[str] | None, Parameter(negative=(), consume_multiple=True)] = None,
    objects: str = "",
    stroke: StrokeKind = "slide",
    input: Path | None = None,  # noqa: A002 - the flag's name
    full_scale: FullScale = None,
    array: ArrayNames = None,
    rate: FrameRate = None,
    rest: float = 0.0,
    noise_n: float = NOISE_N,
    defect: Annotated[list[str] | None, Parameter(negative=(), consume_multiple=True)] = None,
    drift: Annotated[list[str] | None, Parameter(negative=(), consume_multiple=True)] = None,
    seed: int = 0,
    store: Path | None = None,
    firmware: Annotated[bool, Parameter(negative=())] = False,
) -> None:
    """Run the virtual CANopen nodes of a skin.

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
    objects
        Comma-separated names of the objects that touch the skin, ``paper`` for the paper's sixteen; default: a series
        of five.
    stroke
        ``slide``: objects press at any place and angle, and slide. ``press``: as in the paper's classification, within
        10 mm and 45 degrees of the middle, 9.99 mm deep, without a slide.
    input
        A recording to play in place of the simulator: .npz, .npy or .csv of shape (time, rows, columns).
    rest
        Seconds without touch before the first object.
    noise_n
        Standard deviation of the sensor noise in newtons. Recordings get none: they contain their own noise.
    defect
        Defects of the taxels, each KIND or KIND=AMOUNT (default amount in brackets). Fraction of the taxels: dead,
        stuck, saturated, noisy (0.01). Standard deviation of the gains: gain-spread (0.1). Largest
        offset / range: offset (0.13). Fraction of each neighbour's force: cross-talk (0.1). Drift of zero, N/s: drift
        (0.0001). Damping, N s/m: damper (0.01). Part of a force by which its reading creeps up, and the zero is low
        after it: creep (0.05). Of sums that are made in hardware (taxels.frontend = "analogue"):
        standard deviation of the gains of their two paths: mismatch (0.01); of their offsets, N: sum-offset (0.01); of
        the noise behind the addition, N: sum-noise (0.001); time between two sums of a block, s: skew (0.0001).
    drift
        Drifts of zero at a place, each PLACE:COURSE:AMOUNT_N[:START_S[:DURATION_S]]. PLACE: whole, half (the left one),
        gradient (from 0 to the amount across the columns), patchSIDE or patchSIDE@ROW,COLUMN (a square of taxels),
        boardBLOCK (the taxels of a block), converterBLOCK. COURSE: step, ramp (60 s), exponential (time constant 60 s),
        daily (a sine, 24 h).
    seed
        Seed of the touches, of the noise, and of the choice of defective taxels and of patches that drift.
    store
        Folder for the parameters that 1010h stores, one file per node, like the flash memory of a board.
    firmware
        Run the C firmware of the boards (``skin export firmware``) in place of nodes in Python. The system's C compiler
        (cc) compiles the firmware once.

    Examples
    --------
    skin nodes --objects golf-ball
    skin nodes --defect dead=0.02 cross-talk drift
    skin nodes --drift patch12:ramp:0.003:10:60 whole:step:-0.002:5
    skin nodes -i socketcan -c vcan0 --only bus0:1-16
    """
    if seed < 0 or not 0 <= noise_n < math.inf:
        raise InputError(f"expected 0 or more: got --noise-n {noise_n:g} --seed {seed}")
    check_touch_options(input, stroke, full_scale, array, rate)
    if input is not None and rest:
        raise InputError("--rest is for objects: a recording begins as it begins")
    if firmware and store is not None:
        raise InputError("--store is for nodes in Python: boards with --firmware keep their parameters until they end")
    if store is not None:
        try:
            store.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"--store {store}: expected a folder that can be written: {error.strerror}") from error
    stop = StopSignal().install()
    skin = load_layout(layout)
    defects = parse_defects(defect or (), seed, is_analogue=skin.taxels.is_analogue)
    defects |= parse_drifts(drift or (), seed, skin)
    contract = Contract.from_layout(skin)
    chosen = choose_nodes(contract, only or [], without or [])
    source = (
        load_recording(skin, input, full_scale, array, rate)
        if input
        else _objects(skin, objects, stroke, seed=seed, rest_s=rest)
    )
    mine = [node for node in contract.nodes if node.node_id in chosen.get(node.bus, ())]
    compiled = None
    if firmware:
        require_one_state(skin, "the firmware in C")
        compiled = Firmware(contract, mine)
    blocks = [node.block for node in mine]
    hardware = new_hardware(contract, blocks, source, compiled, noise_n=noise_n, seed=seed, defects=defects)
    links = open_links(skin, bus or BusOptions(), chosen, name="nodes", stop=stop)
    mark = contract.phi.fingerprint
    joined = Fabric(skin.name, "nodes", connect, stop=stop, fingerprint=mark) if fabric else None
    service = NodesService(contract, links, chosen, hardware, joined, store=store, firmware=compiled)
    count = sum(map(len, chosen.values()))
    say("nodes", f"{count} node{'s' * (count != 1)} on {len(links)} bus{'es' * (len(links) != 1)}")
    try:
        service.run(stop)
    finally:
        for link in links.values():
            link.close()
        if joined is not None:
            joined.close()


def _objects(skin: Layout, names: str, stroke: StrokeKind, **options: Any) -> TaxelSource:
    return load_objects(skin, names=object_names([names]) or None, stroke=stroke, **options)
