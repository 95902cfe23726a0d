"""What the way of sending decides of a printed plan: boards that send in every cycle, or in slots."""

from collections.abc import Sequence

from bandwidth.alternatives import alternatives
from bandwidth.plan import BusPlan
from bandwidth.traffic import Disturbance
from dbc.contract import Contract
from dbc.packing import rounding_error_n


def facts(contract: Contract, allowed: Disturbance) -> dict[str, object]:
    """Return the way of sending; of cycles rounding and alternatives."""
    layout = contract.layout
    if contract.in_steps:
        return {"sending": layout.sending, "steps": layout.steps}
    return {
        "sum_bits": layout.encoding.sum_bits,
        "rounding_error_n": rounding_error_n(layout),
        "alternatives": list(alternatives(layout, allowed)),
    }


def print_plans(contract: Contract, plans: Sequence[BusPlan], allowed: Disturbance) -> None:
    """Print the plans, and of cycles alternatives."""
    from bandwidth.tables import print_plan, print_slot_plan

    if contract.in_steps:
        print_slot_plan(plans)
        return
    print_plan(plans, alternatives(contract.layout, allowed))
