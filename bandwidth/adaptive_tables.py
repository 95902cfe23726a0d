"""Tables of buses with adaptive nodes: plans and measured loads."""

from collections.abc import Sequence

from bandwidth.adaptive_log import AdaptiveLoad
from bandwidth.adaptive_plan import AdaptiveBusPlan, BudgetPlan
from bandwidth.tables import ms, node_lines, number, percent, print_wrapped
from skin.terminal import print_table


def print_adaptive_plan(plans: Sequence[AdaptiveBusPlan]) -> None:
    """Print a plan: a column per bus, the nodes' waits, the problems."""
    rows = {
        "nodes": [str(each.nodes) for each in plans],
        "load, idle / touched": [f"{percent(each.load_idle)} / {percent(each.load_touched)}" for each in plans],
        "load, everything moves": [percent(each.load_worst) for each in plans],
        "groups that fill the bus, a frame every ms": [str(each.groups_fill) for each in plans],
        "coarse sums, everything moves, at worst, ms": [ms(each.coarse_ms) for each in plans],
        "refresh, everything moves, at worst, ms": [ms(each.refresh_ms) for each in plans],
        "SDO response, everything moves, at worst, ms": [ms(each.sdo_response_ms) for each in plans],
        "heartbeat, everything moves, at worst, ms": [ms(each.heartbeat_response_ms) for each in plans],
        "all coarse / all fine after rest, at worst, ms": [
            f"{ms(each.settled_coarse_ms)} / {ms(each.settled_fine_ms)}" for each in plans
        ],
        "budget of a node for a load of 80 %, bit/s": [str(each.budget_80_bits_per_s) for each in plans],
        "receive buffer, frames / bytes": [
            f"{each.receive_buffer_frames} / {each.receive_buffer_bytes}" for each in plans
        ],
    }
    budgets = [each.budget for each in plans if each.budget is not None]
    if budgets:
        rows |= _budget_rows(budgets)
    print_table(["", *(each.name for each in plans)], [[name, *cells] for name, cells in rows.items()])
    print("\ncoarse sums of each node while everything moves, at worst, ms:")
    print_wrapped(
        node_lines({each.name: [(node.node_id, node.coarse_ms) for node in each.node_plans] for each in plans})
    )
    for plan in plans:
        for problem in plan.problems:
            print(f"does not fit: {problem}")


def _budget_rows(budgets: Sequence[BudgetPlan]) -> dict[str, list[str]]:
    given = f"with {budgets[0].bits_per_s} bit/s for each node:"
    return {
        f"{given} load": [percent(each.load) for each in budgets],
        "  bus full for at most, ms": [ms(each.full_ms) for each in budgets],
        "  coarse sums, everything moves, ms": [ms(each.coarse_ms) for each in budgets],
        "  fine sums of a node at rest, ms": [ms(each.fine_ms) for each in budgets],
    }


def print_adaptive_loads(loads: Sequence[AdaptiveLoad]) -> None:
    """Print measured loads beside the plan, and the frames of each bus by kind and level, and by node."""
    rows: list[list[object]] = [
        ["measured, s", *(f"{each.bus.seconds:.2f}" for each in loads)],
        ["frames", *(each.bus.frames for each in loads)],
        ["load", *(percent(each.bus.load_exact) for each in loads)],
        ["load planned, touched", *(percent(each.bus.plan_touched) for each in loads)],
        ["load with most stuff bits", *(percent(each.bus.load_worst) for each in loads)],
        ["errors reported", *(each.bus.errors for each in loads)],
    ]
    print_table(["", *(each.bus.name for each in loads)], rows)
    for each in loads:
        print()
        _print_bus(each)


def _print_bus(load: AdaptiveLoad) -> None:
    rows = [
        [f"{each.kind}, level {each.level}", each.frames, number(each.rate_hz, 1), f"{each.load_exact:.3%}"]
        for each in load.levels
    ]
    others: dict[str, list[float]] = {}
    for each in load.bus.identifiers:
        if each.kind not in {"coarse", "fine"}:
            total = others.setdefault(each.kind, [0, 0.0, 0.0])
            for place, part in enumerate((each.frames, each.rate_hz, each.load_exact)):
                total[place] += part
    rows += [[kind, int(count), number(rate_hz, 1), f"{share:.3%}"] for kind, (count, rate_hz, share) in others.items()]
    print_table(["kind", "frames", "a second", "load"], rows, title=load.bus.name)
    shares = [
        [each.node_id, each.news, each.again, each.fine, each.unrefined, each.heartbeats, f"{each.load_exact:.3%}"]
        for each in load.nodes
    ]
    headings = ["node", "coarse, new", "coarse, again", "fine", "fine, unrefined", "heartbeats", "load"]
    print_table(headings, shares)
