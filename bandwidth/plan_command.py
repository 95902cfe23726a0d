"""``skin plan``: what a layout asks of its buses, and the layout that meets a wish."""

from pathlib import Path
from typing import Annotated

import msgspec
from cyclopts import Parameter

from bandwidth.alternatives import alternatives
from bandwidth.layout_text import layout_text
from bandwidth.plan import BusPlan
from bandwidth.plan import plan as plan_buses
from bandwidth.schemes import schemes
from bandwidth.search import Kind, Wish, search, what_is_missing
from bandwidth.traffic import Disturbance
from bus.options import BusOptions, channels
from dbc.contract import Contract
from dbc.packing import rounding_error_n
from skin.errors import InputError, RunError
from skin.layout import load_layout
from skin.service import say


def plan(
    layout: Path | None = None,
    *,
    check: Path | None = None,
    channel: Annotated[list[str] | None, Parameter(alias="-c", negative=())] = None,
    taxels: int | None = None,
    rate: float | None = None,
    buses: int | None = None,
    budget: float | None = None,
    can: Kind | None = None,
    out: Path | None = None,
    plot: Path | None = None,
    jitter_s: float = 100e-6,
    sdo_per_s: float = 20.0,
    errors_per_s: float = 0.0,
    json_: Annotated[bool, Parameter(name="--json", negative=())] = False,
) -> int:
    """Say what the buses of a skin carry before any hardware is bought, or find the layout that meets a wish.

    Ends with 1 when something does not fit, or a log left the plan.

    Parameters
    ----------
    layout
        TOML of the skin; without it the default skin.
    check
        Compare a log of the buses with the plan, and print one line for each way in which they left it.
    channel
        Channels of that log, one per bus of the layout; default the buses' names, else all in their order.
    taxels
        Search for a layout of so many taxels instead of planning one.
    rate
        Of the search: measurements a second. Default: 100.
    buses
        Of the search: how many buses there may be. Default: 4.
    budget
        Of the search: the part of each bus that may be used at worst. Default: 0.8.
    can
        Of the search: which kind of CAN; default any.
    out
        Of the search: file for the TOML of the layout, else it is printed.
    plot
        Folder for pictures: rates against buses and widths, the time line of one cycle.
    jitter_s
        How long after SYNC the slowest node has its TPDOs queued.
    sdo_per_s
        SDO transfers a second that response times allow for.
    errors_per_s
        Disturbed frames a second that response times allow for.
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
        wish = Wish(
            taxels,
            rate_hz=100.0 if rate is None else rate,
            buses=4 if buses is None else buses,
            budget=0.8 if budget is None else budget,
            can=can or "any",
        )
        return _search(wish, allowed, out, as_json=json_)
    wished = {"--rate": rate, "--buses": buses, "--budget": budget, "--can": can, "--out": out}
    idle = [name for name, value in wished.items() if value is not None]
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
        print(msgspec.json.encode(_document(contract, plans, allowed)).decode())
    else:
        from bandwidth.tables import plan_tables, shown

        print(shown(plan_tables(plans, alternatives(contract.layout, allowed))))
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


def _search(wish: Wish, allowed: Disturbance, out: Path | None, *, as_json: bool) -> int:
    found, seen = search(wish, allowed)
    text = layout_text(found) if found is not None else None
    if text is not None and out is not None:
        try:
            out.write_text(text, encoding="utf-8")
        except OSError as error:
            raise InputError(f"{out}: cannot write the layout: {error.strerror or error}") from error
    if as_json:
        missing = None if text is not None else what_is_missing(wish, seen, allowed)
        document = {"wish": wish, "fits": text is not None, "layout": text, "missing": missing, "candidates": seen}
        print(msgspec.json.encode(document).decode())
        return int(text is None)
    if text is None:
        raise RunError(what_is_missing(wish, seen, allowed))
    chosen = seen[-1]
    say(
        "plan",
        f"{chosen.words}: each bus {chosen.load_worst or 0:.1%} full at worst; {len(seen) - 1} others did not do",
    )
    print(str(out) if out is not None else text, end="\n" if out is not None else "")
    return 0


def _check(contract: Contract, plans: list[BusPlan], log: Path, names: list[str], *, as_json: bool) -> int:
    from bandwidth.departures import departures
    from bandwidth.logs import of_buses, read_log
    from bandwidth.measured import measure

    wanted = channels(contract.layout, BusOptions(channel=names))
    lines = []
    for number, seen in of_buses(contract.layout, wanted, read_log(log), log, named_by_user=bool(names)).items():
        load = measure(contract, number, seen, plans[number])
        say("plan", f"{load.name}: {load.seconds:.2f} s, {load.load_exact:.1%} full, {load.plan_average:.1%} planned")
        lines += departures(contract, number, seen, plans[number], load)
    if as_json:
        print(msgspec.json.encode(lines).decode())
    elif lines:
        print("\n".join(lines))
    return int(bool(lines))
