"""``skin plan``: the load of a layout's buses."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from bandwidth.bit_timing import TimingOptions, bus_timings, print_timings
from bandwidth.plan import BusPlan
from bandwidth.plan import plan as plan_buses
from bandwidth.sending import facts, print_plans
from bandwidth.traffic import Disturbance
from bandwidth.wiring import wiring
from bus.options import BusOptions, Channels, channels
from canskin.errors import InputError
from dbc.contract import Contract
from shell.service import say
from shell.terminal import Json, print_json
from skin.choice import chosen, scan_words
from skin.layout import Layout, layout_tables, load_layout, require_sending

if TYPE_CHECKING:
    from demo.quality import Quality


def plan(
    layout: Path | None = None,
    *,
    check: Path | None = None,
    channel: Channels | None = None,
    plot: Path | None = None,
    disturbance: Disturbance | None = None,
    quality: Annotated[bool, Parameter(negative=())] = False,
    timing: Annotated[bool, Parameter(negative=())] = False,
    controllers: TimingOptions | None = None,
    json_: Json = False,
) -> int:
    """Compute the bus load of a skin, and the length of its wires, before any hardware is bought.

    Exit code 1: a bus does not fit, a log differs from the plan, or a clock cannot make the bit rates. ``skin design``
    searches for a layout.

    Parameters
    ----------
    layout
        TOML of the skin; without it the default skin.
    check
        Compare a log of the buses with the plan, and print a line for each difference.
    channel
        The channel of each bus in the log. Default: the names of the buses, else all channels in their order. With
        ``--timing`` the network interface of each bus, by default can0 and the next.
    plot
        Folder for ``cycle.png``, the time line of one cycle.
    disturbance
        Disturbances that response times include.
    quality
        Predict the images, too: PSNR and error under twelve seconds of simulated touches. Takes some seconds, with
        thousands of stepped taxels a minute.
    timing
        Print the bit timing of CAN controllers, and the ``ip link`` command of each bus, in place of the load.
    controllers
        Controllers and wires for ``--timing``.
    json_
        Print one JSON object.

    Examples
    --------
    skin plan palm.toml --plot pictures
    skin plan palm.toml --check candump-2026-11-20_120000.log
    skin plan palm.toml --quality
    skin plan steps
    skin plan fd --timing --clock-hz 40000000 --bus-length-m 5
    """
    skin = load_layout(layout)
    if timing and (check is not None or plot is not None or quality):
        raise InputError("expected --timing, --check, --plot or --quality, got --timing with another of them")
    if channel and not timing and check is None:
        raise InputError("--channel is for --check and --timing: the plan of a layout needs no channels")
    if timing:
        return _timing(skin, channel or ["can0"], controllers or TimingOptions(), as_json=json_)
    if controllers is not None:
        raise InputError("--clock-hz, --bus-length-m and --loop-delay-ns are for --timing")
    contract = Contract.from_layout(skin)
    allowed = (disturbance or Disturbance()).of(contract.layout)
    if plot is not None:
        require_sending(contract.layout, "synchronous", "--plot is", "it draws cycles, and stepped nodes send none")
    plans = plan_buses(contract, allowed=allowed, is_touched=check is None)
    if check is not None:
        return _check(contract, plans, check, channel or [], as_json=json_)
    if plot is not None:
        from bandwidth.plots import write_plot

        say("plan", f"wrote {write_plot(contract, plot)}")
    does_fit = not any(each.problems for each in plans)
    images = _images(contract.layout, asked=quality)
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
            "quality": [each._asdict() for each in images],
        }
        print_json(about | facts(contract, allowed))
    else:
        print_plans(contract, plans, allowed)
        predicted = (f"images of simulated touches: {each.words}" for each in images)
        print("", wiring(contract.layout), *predicted, *words, *[scan] * bool(scan), sep="\n")
    return int(not does_fit)


def _images(layout: Layout, *, asked: bool) -> "list[Quality]":
    if not asked:
        return []
    from demo.prediction import say_of_host  # compiles a solver, which no other plan needs
    from demo.quality import quality

    say_of_host("plan", layout)
    return [quality(layout)]


def _timing(layout: Layout, names: list[str], options: TimingOptions, *, as_json: bool) -> int:
    timings = bus_timings(layout.bus, channels(layout, BusOptions("socketcan", names)), options)
    print_json(timings) if as_json else print_timings(timings)
    enough = all if options.clock_hz else any
    return int(not all(enough(not one.problem for one in each.controllers) for each in timings))


def _check(
    contract: Contract,
    plans: Sequence[BusPlan],
    log: Path,
    names: list[str],
    *,
    as_json: bool,
) -> int:
    from bandwidth.departures import departures
    from bandwidth.logs import of_buses, read_log
    from bandwidth.measured import measure, misfits

    wanted = channels(contract.layout, BusOptions(channel=names))
    logged = read_log(log, lambda line: say("plan", line))
    lines = []
    for number, seen in of_buses(contract.layout, wanted, logged, log, named_by_user=bool(names)).items():
        load = measure(contract, number, seen, plans[number])
        wanted_load = "" if load.plan_touched is None else f", {load.plan_touched:.1%} planned"
        say("plan", f"{load.name}: {load.seconds:.2f} s, {load.load_exact:.1%} full{wanted_load}")
        for line in misfits(contract, number, seen, load):
            say("plan", line)
        lines += departures(contract, number, seen, plans[number], load)
    if as_json:
        print_json(lines)
    elif lines:
        print("\n".join(lines))
    return int(bool(lines))
