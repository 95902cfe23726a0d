"""``skin plan``: the load of a layout's buses."""

from pathlib import Path

from bandwidth.adaptive_plan import AdaptiveBusPlan, plan_adaptive
from bandwidth.alternatives import alternatives
from bandwidth.plan import BusPlan
from bandwidth.plan import plan as plan_buses
from bandwidth.scheme_rates import schemes
from bandwidth.traffic import Disturbance
from bandwidth.wiring import wiring
from bus.options import BusOptions, Channels, channels
from canskin.errors import InputError
from dbc.contract import Contract
from dbc.packing import rounding_error_n
from skin.layout import load_layout, require_one_state
from skin.service import say
from skin.terminal import Json, print_json


def plan(
    layout: Path | None = None,
    *,
    check: Path | None = None,
    channel: Channels | None = None,
    plot: Path | None = None,
    node_budget: int = 0,
    disturbance: Disturbance | None = None,
    json_: Json = False,
) -> int:
    """Compute the bus load of a skin, and the length of its wires, before any hardware is bought.

    Exit code 1: a bus does not fit, or a log differs from the plan. ``skin design`` searches for a layout.

    Parameters
    ----------
    layout
        TOML of the skin; without it the default skin.
    check
        Compare a log of the buses with the plan, and print a line for each difference.
    channel
        The channel of each bus in the log. Default: the names of the buses, else all channels in their order.
    plot
        Folder for pictures: rates for other numbers of buses and widths of sums; time line of one cycle.
    node_budget
        Adaptive sending: bits a second that each node may send (object 2034h); 0 for no budget.
    disturbance
        Disturbances that response times include.
    json_
        Print one JSON object.

    Examples
    --------
    skin plan palm.toml --plot pictures
    skin plan palm.toml --check candump-2026-11-20_120000.log
    skin plan adaptive --node-budget 24000
    """
    contract = Contract.from_layout(load_layout(layout))
    allowed = (disturbance or Disturbance()).of(contract.layout)
    if contract.layout.sending == "adaptive":
        if plot is not None:
            raise InputError("--plot draws cycles, and adaptive nodes send none: leave the option out")
        return _plan_adaptive(contract, allowed, node_budget, check, channel or [], as_json=json_)
    if node_budget:
        raise InputError("--node-budget is for adaptive sending: the nodes of this layout send in every cycle")
    plans = plan_buses(contract, allowed=allowed)
    few = [] if contract.recognition is None else plan_buses(contract.recognition, allowed=allowed)
    if check is not None:
        require_one_state(contract.layout, "--check")
        return _check(contract, plans, check, channel or [], as_json=json_)
    if plot is not None:
        from bandwidth.plots import write_plots

        for path in write_plots(contract, plot):
            say("plan", f"wrote {path}")
    if json_:
        print_json(_document(contract, plans, allowed) | ({"recognition": few} if few else {}))
    else:
        from bandwidth.tables import print_buses, print_plan, print_problems

        if few:
            print("recognition")
            print_buses(few)
            print_problems(few)
            print("\nimages")
        print_plan(plans, alternatives(contract.layout, allowed))
        print(f"\n{wiring(contract.layout)}")
    return int(any(each.problems for each in [*plans, *few]))


def _plan_adaptive(
    contract: Contract, allowed: Disturbance, budget: int, log: Path | None, names: list[str], *, as_json: bool
) -> int:
    plans = plan_adaptive(contract, allowed=allowed, budget_bits_per_s=budget, is_touched=log is None)
    if log is not None:
        return _check(contract, plans, log, names, as_json=as_json)
    if as_json:
        layout = contract.layout
        print_json(
            {
                "name": layout.name,
                "sending": layout.sending,
                "sync_rate_hz": layout.sync.rate_hz,
                "taxels": layout.taxels.count,
                "sums": layout.measurement.sums,
                "allowed": allowed,
                "fits": not any(each.problems for each in plans),
                "buses": plans,
                "wiring": wiring(layout),
            }
        )
    else:
        from bandwidth.adaptive_tables import print_adaptive_plan

        print_adaptive_plan(plans)
        print(f"\n{wiring(contract.layout)}")
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
        "wiring": wiring(layout),
        "alternatives": list(alternatives(layout, allowed)),
        "schemes": list(schemes(layout)),
    }


def _check(
    contract: Contract,
    plans: list[BusPlan] | list[AdaptiveBusPlan],
    log: Path,
    names: list[str],
    *,
    as_json: bool,
) -> int:
    from bandwidth.adaptive_departures import adaptive_departures
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
        planned = plans[number]
        if isinstance(planned, BusPlan):
            lines += departures(contract, number, seen, planned, load)
        else:
            lines += adaptive_departures(contract, number, seen, planned, load)
    if as_json:
        print_json(lines)
    elif lines:
        print("\n".join(lines))
    return int(bool(lines))
