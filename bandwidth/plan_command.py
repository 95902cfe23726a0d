"""``skin plan``: the load of a layout's buses, and a search for a layout that meets a requirement."""

from pathlib import Path

from bandwidth.alternatives import alternatives
from bandwidth.plan import BusPlan
from bandwidth.plan import plan as plan_buses
from bandwidth.scheme_rates import schemes
from bandwidth.search import CanKind, Requirement, search
from bandwidth.traffic import Disturbance
from bus.options import BusOptions, Channels, channels
from dbc.contract import Contract
from dbc.packing import rounding_error_n
from skin.errors import InputError, RunError
from skin.layout import layout_text, load_layout
from skin.output import write_file
from skin.service import say
from skin.terminal import Json, print_json


def plan(
    layout: Path | None = None,
    *,
    check: Path | None = None,
    channel: Channels | None = None,
    taxels: int | None = None,
    rate: float | None = None,
    buses: int | None = None,
    budget: float | None = None,
    can: CanKind | None = None,
    out: Path | None = None,
    plot: Path | None = None,
    jitter_s: float = 100e-6,
    sdo_per_s: float = 20.0,
    errors_per_s: float = 0.0,
    json_: Json = False,
) -> int:
    """Compute the bus load of a skin before any hardware is bought, or search for a layout.

    Exit code 1: a bus does not fit, no layout was found, or a log differs from the plan.

    Parameters
    ----------
    layout
        TOML of the skin; without it the default skin.
    check
        Compare a log of the buses with the plan, and print a line for each difference.
    channel
        The channel of each bus in the log. Default: the names of the buses, else all channels in their order.
    taxels
        Search for a layout with this number of taxels, a power of two, instead of planning a layout.
    rate
        Search: measurements per second. Default: 100.
    buses
        Search: largest number of buses. Default: 4.
    budget
        Search: highest load of a bus, with the most stuff bits, as a part of 1. Default: 0.8.
    can
        Search: type of CAN. Default: any.
    out
        Search: file for the TOML of the layout. Default: print the layout.
    plot
        Folder for pictures: rates for other numbers of buses and widths of sums; time line of one cycle.
    jitter_s
        Response times: time from SYNC until the slowest node has queued its TPDOs, seconds.
    sdo_per_s
        Response times: SDO transfers per second.
    errors_per_s
        Response times: disturbed frames per second.
    json_
        Print one JSON object.

    Examples
    --------
    skin plan palm.toml --plot pictures
    skin plan --taxels 4096 --rate 100 --buses 2 --budget 0.7 --out palm.toml
    """
    allowed = Disturbance(jitter_s, sdo_per_s, errors_per_s)
    if taxels is not None:
        if layout is not None or check is not None or plot is not None:
            raise InputError("expected --taxels or a layout, not both: a search makes its own")
        required = Requirement(
            taxels,
            rate_hz=100.0 if rate is None else rate,
            buses=4 if buses is None else buses,
            budget=0.8 if budget is None else budget,
            can=can or "any",
        )
        return _search(required, allowed, out, as_json=json_)
    only_search = {"--rate": rate, "--buses": buses, "--budget": budget, "--can": can, "--out": out}
    idle = [name for name, value in only_search.items() if value is not None]
    if idle:
        raise InputError(f"{' and '.join(idle)}: only for the search of a layout: give --taxels as well")
    contract = Contract.from_layout(load_layout(layout))
    plans = plan_buses(contract, allowed=allowed)
    if check is not None:
        return _check(contract, plans, check, channel or [], as_json=json_)
    if plot is not None:
        from bandwidth.plots import write_plots

        for path in write_plots(contract, plot):
            say("plan", f"wrote {path}")
    if json_:
        print_json(_document(contract, plans, allowed))
    else:
        from bandwidth.tables import print_plan

        print_plan(plans, alternatives(contract.layout, allowed))
    return int(any(each.problems for each in plans))


def _document(contract: Contract, plans: list[BusPlan], allowed: Disturbance) -> dict[str, object]:
    layout = contract.layout
    return {
        "name": layout.name,
        "sync_rate_hz": layout.sync.rate_hz,
        "taxels": layout.taxels.count,
        "sums": layout.measurement.sums,
        "sum_bits": layout.encoding.sum_bits,
        "rounding_error_n": rounding_error_n(layout),
        "allowed": allowed,
        "fits": not any(each.problems for each in plans),
        "buses": plans,
        "alternatives": list(alternatives(layout, allowed)),
        "schemes": list(schemes(layout)),
    }


def _search(required: Requirement, allowed: Disturbance, out: Path | None, *, as_json: bool) -> int:
    found = search(required, allowed)
    text = None if found.layout is None else layout_text(found.layout)
    if text is not None and out is not None:
        try:
            write_file(out, text)
        except OSError as error:
            raise InputError(f"{out}: cannot write the layout: {error.strerror or error}") from error
    if as_json:
        print_json(
            {
                "required": required,
                "fits": text is not None,
                "layout": text,
                "missing": found.missing(),
                "candidates": found.candidates,
            }
        )
        return int(text is None)
    if text is None or found.chosen is None:
        raise RunError(found.missing() or "")
    unfit = sum(not each.fits for each in found.candidates)
    say(
        "plan",
        f"{found.chosen.words}: each bus {found.chosen.load_worst or 0:.1%} full at worst; {unfit} others do not fit",
    )
    print(str(out) if out is not None else text, end="\n" if out is not None else "")
    return 0


def _check(contract: Contract, plans: list[BusPlan], log: Path, names: list[str], *, as_json: bool) -> int:
    from bandwidth.departures import departures
    from bandwidth.logs import of_buses, read_log
    from bandwidth.measured import measure, misfits

    wanted = channels(contract.layout, BusOptions(channel=names))
    logged = read_log(log, lambda line: say("plan", line))
    lines = []
    for number, seen in of_buses(contract.layout, wanted, logged, log, named_by_user=bool(names)).items():
        load = measure(contract, number, seen, plans[number])
        say(
            "plan",
            f"{load.name}: {load.seconds:.2f} s, {load.load_exact:.1%} full, {load.plan_touched or 0:.1%} planned",
        )
        for line in misfits(contract, number, seen, load):
            say("plan", line)
        lines += departures(contract, number, seen, plans[number], load)
    if as_json:
        print_json(lines)
    elif lines:
        print("\n".join(lines))
    return int(bool(lines))
