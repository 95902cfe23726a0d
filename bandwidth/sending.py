"""What the way of sending decides of a printed plan: boards that send in every cycle, or in slots."""

from collections.abc import Sequence

from bandwidth.alternatives import alternatives
from bandwidth.plan import BusPlan, plan
from bandwidth.traffic import Disturbance
from dbc.contract import Contract
from dbc.packing import rounding_error_n


def plan_states(contract: Contract, allowed: Disturbance | None = None, *, is_touched: bool = True) -> list[BusPlan]:
    """Plan all buses, also in recognition."""
    return [each for state in contract.states for each in plan(state, allowed=allowed, is_touched=is_touched)]


def facts(contract: Contract, plans: Sequence[BusPlan], allowed: Disturbance) -> dict[str, object]:
    """Return the way of sending; of cycles rounding, alternatives, and the plans of recognition where there is that."""
    layout = contract.layout
    if contract.in_steps:
        return {"sending": layout.sending, "steps": layout.steps}
    few = plans[len(layout.bus) :]
    return {
        "sum_bits": layout.encoding.sum_bits,
        "rounding_error_n": rounding_error_n(layout),
        "alternatives": list(alternatives(layout, allowed)),
    } | ({"recognition": few} if few else {})


def print_plans(contract: Contract, plans: Sequence[BusPlan], allowed: Disturbance) -> None:
    """Print the plans of all states, and of cycles alternatives."""
    from bandwidth.tables import print_buses, print_plan, print_problems, print_slot_plan

    buses = len(contract.layout.bus)
    if contract.in_steps:
        print_slot_plan(plans)
        return
    if few := plans[buses:]:
        print("recognition")
        print_buses(few)
        print_problems(few)
        print("\nimages")
    print_plan(plans[:buses], alternatives(contract.layout, allowed))
