"""``skin plan``: the load of a layout's buses."""

from collections.abc import Sequence
from pathlib import Path

from bandwidth.adaptive_plan import AdaptiveBusPlan
from bandwidth.plan import BusPlan
from bandwidth.sending import sending_of
from bandwidth.traffic import Disturbance
from bandwidth.wiring import wiring
from bus.options import BusOptions, Channels, channels
from dbc.contract import Contract
from shell.service import say
from shell.terminal import Json, print_json
from skin.layout import load_layout, require_one_state, require_sending


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
        Folder for ``cycle.png``, the time line of one cycle.
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
    allowed, sending = (disturbance or Disturbance()).of(contract.layout), sending_of(contract)
    if node_budget:
        require_sending(contract.layout, "adaptive", "--node-budget is", "the nodes of this layout send in every cycle")
    if plot is not None:
        require_sending(contract.layout, "synchronous", "--plot is", "it draws cycles, and adaptive nodes send none")
    plans = sending.plan(contract, allowed, node_budget=node_budget, is_touched=check is None)
    if check is not None:
        require_one_state(contract.layout, "--check")
        return _check(contract, plans, check, channel or [], as_json=json_)
    if plot is not None:
        from bandwidth.plots import write_plot

        say("plan", f"wrote {write_plot(contract, plot)}")
    does_fit = not any(each.problems for each in plans)
    if json_:
        facts = {
            "name": contract.layout.name,
            "sync_rate_hz": contract.layout.sync.rate_hz,
            "taxels": contract.layout.taxels.there,
            "sums": contract.layout.measurement.sums,
            "allowed": allowed,
            "fits": does_fit,
            "buses": plans[: len(contract.layout.bus)],
            "wiring": wiring(contract.layout),
        }
        print_json(facts | sending.facts(contract, plans, allowed))
    else:
        sending.print_plan(contract, plans, allowed)
        print(f"\n{wiring(contract.layout)}")
    return int(not does_fit)


def _check(
    contract: Contract,
    plans: Sequence[BusPlan] | Sequence[AdaptiveBusPlan],
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
