"""``skin plan``: the load of a layout's buses, and a search for the layout that meets a requirement."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from bandwidth.bit_timing import TimingOptions, bus_timings, print_timings
from bandwidth.design import NO_DESIGN, DesignOptions, design
from bandwidth.plan import plan as plan_buses
from bandwidth.tables import print_plan, print_slot_plan
from bandwidth.traffic import Disturbance
from bandwidth.wiring import wiring
from bus.options import BusOptions, Channels, channels
from canskin.errors import InputError
from dbc.contract import Contract
from dbc.packing import rounding_error_n
from shell.terminal import Json, print_json, print_table, progress
from skin.choice import chosen, scan_words
from skin.layout import Layout, layout_tables, load_layout

if TYPE_CHECKING:
    from bandwidth.quality import Quality


def plan(
    layout: Path | None = None,
    *,
    design_: DesignOptions = NO_DESIGN,
    channel: Channels | None = None,
    disturbance: Disturbance | None = None,
    quality: Annotated[bool, Parameter(negative=())] = False,
    timing: Annotated[bool, Parameter(negative=())] = False,
    controllers: TimingOptions | None = None,
    json_: Json = False,
) -> int:
    """Compute the bus load of a skin, and the length of its wires, before any hardware is bought.

    With ``--taxels`` search for a layout whose buses carry so many. Exit code 1: a bus does not fit, no layout was
    found, or a clock cannot make the bit rates.

    Parameters
    ----------
    layout
        TOML of the skin; without it the default skin.
    design_
        A search for a layout.
    channel
        ``--timing``: the network interface of each bus, by default can0 and the next.
    disturbance
        Disturbances that response times include.
    quality
        Predict the images, too, under twelve seconds of simulated touches: PSNR and error with the sums of the layout;
        of sums in cycles also with 16, 8, 4, 2 and 1 taxels to a sum. Takes seconds, with thousands of stepped taxels
        a minute.
    timing
        Print the bit timing of CAN controllers, and the ``ip link`` command of each bus, in place of the load.
    controllers
        Controllers and wires for ``--timing``.
    json_
        Print one JSON object.

    Examples
    --------
    skin plan palm.toml
    skin plan palm.toml --quality
    skin plan fd --timing --clock-hz 40000000 --bus-length-m 5
    skin plan --taxels 1024 --can fd
    skin plan --taxels 24x32 --sending steps --out glove.toml
    skin plan --taxels 4096 --rate 100 --buses 2 --budget 0.7 --out palm.toml
    """
    if timing and quality:
        raise InputError("expected --timing or --quality, got both")
    if channel and not timing:
        raise InputError("--channel is for --timing: the plan of a layout needs no channels")
    if controllers is not None and not timing:
        raise InputError("--clock-hz, --bus-length-m and --loop-delay-ns are for --timing")
    if design_ != NO_DESIGN:
        if layout is not None or timing or quality:
            raise InputError("a search with --taxels takes no layout, --timing or --quality: plan what it has found")
        return design(design_, disturbance, as_json=json_)
    skin = load_layout(layout)
    if timing:
        return _timing(skin, channel or ["can0"], controllers or TimingOptions(), as_json=json_)
    contract = Contract.from_layout(skin)
    allowed = (disturbance or Disturbance()).of(contract.layout)
    plans = plan_buses(contract, allowed=allowed)
    does_fit = not any(each.problems for each in plans)
    judged = _judged(contract.layout) if quality else []
    scan = scan_words(skin)
    words = chosen(skin, layout_tables(layout)[0])
    if json_:
        about = {
            "name": contract.layout.name,
            "sync_rate_hz": contract.layout.sync.rate_hz,
            "taxels": contract.layout.taxels.there,
            "sums": contract.layout.measurement.sums,
            "allowed": allowed,
            "fits": does_fit,
            "buses": plans,
            "wiring": wiring(contract.layout),
            "chosen": words,
            "scan": scan,
            "quality": [each._asdict() for each in judged],
            "sending": skin.sending,
            **({"steps": skin.steps} if contract.in_steps else _of_cycles(skin)),
        }
        print_json(about)
    else:
        (print_slot_plan if contract.in_steps else print_plan)(plans)
        print("", wiring(contract.layout), *words, *[scan] * bool(scan), sep="\n")
        if judged:
            print(f"\nimages of simulated touches: {judged[0].words}")
            _print_quality(judged)
    return int(not does_fit)


def _of_cycles(layout: Layout) -> dict[str, object]:
    return {"sum_bits": layout.encoding.sum_bits, "rounding_error_n": rounding_error_n(layout)}


def _judged(layout: Layout) -> "list[Quality]":
    from bandwidth.quality import qualities  # compiles a solver, which no other plan needs

    with progress("touches, for the images", None):
        return qualities(layout)


def _print_quality(found: "Sequence[Quality]") -> None:
    headings = ("sums", "per taxel", "PSNR, dB", "raw sample, dB", "error where touched, mN", "paper's bound, sums")
    rows = [
        (
            each.sums,
            f"{each.sums_per_taxel:.3f}",
            f"{each.psnr_image_db:.1f}",
            f"{each.psnr_sensor_db:.1f}",
            f"{1e3 * each.touched_error_n:.2f}",
            f"{each.bound_sums:.0f}",
        )
        for each in found
    ]
    print_table(headings, rows)


def _timing(layout: Layout, names: list[str], options: TimingOptions, *, as_json: bool) -> int:
    timings = bus_timings(layout.bus, channels(layout, BusOptions("socketcan", names)), options)
    print_json(timings) if as_json else print_timings(timings)
    enough = all if options.clock_hz else any
    return int(not all(enough(not one.problem for one in each.controllers) for each in timings))
