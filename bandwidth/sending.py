"""What the way of sending decides of plans and loads: boards that send in every cycle, or when they have news."""

import dataclasses
from collections.abc import Sequence
from typing import Any

from bandwidth.adaptive_log import AdaptiveLoad, measure_adaptive
from bandwidth.adaptive_plan import AdaptiveBusPlan, plan_adaptive
from bandwidth.alternatives import alternatives
from bandwidth.measured import BusLoad
from bandwidth.plan import BusPlan, plan
from bandwidth.scheme_rates import schemes
from bandwidth.traffic import Disturbance
from canskin.errors import InputError
from dbc.contract import Contract
from dbc.frame import Frames
from dbc.packing import rounding_error_n


class InCycles:
    """Boards that send all their sums after every SYNC."""

    def check_options(self, *, has_plot: bool, node_budget: int) -> None:  # noqa: ARG002  as of `OnNews`
        """Refuse a budget."""
        if node_budget:
            raise InputError("--node-budget is for adaptive sending: the nodes of this layout send in every cycle")

    def plan(
        self, contract: Contract, allowed: Disturbance | None = None, *, node_budget: int = 0, is_touched: bool = True
    ) -> list[BusPlan]:
        """Plan all buses, also in recognition; a touch is always simulated."""
        del node_budget, is_touched
        return [each for state in contract.states for each in plan(state, allowed=allowed)]

    def facts(self, contract: Contract, plans: Sequence[Any], allowed: Disturbance) -> dict[str, object]:
        """Return rounding, alternatives, and the plans of recognition if there is that state."""
        layout = contract.layout
        few = plans[len(layout.bus) :]
        return {
            "sum_bits": layout.encoding.sum_bits,
            "rounding_error_n": rounding_error_n(layout),
            "alternatives": list(alternatives(layout, allowed)),
            "schemes": list(schemes(layout)),
        } | ({"recognition": few} if few else {})

    def print_plan(self, contract: Contract, plans: Sequence[Any], allowed: Disturbance) -> None:
        """Print the plans of all states, and alternatives."""
        from bandwidth.tables import print_buses, print_plan, print_problems

        buses = len(contract.layout.bus)
        if few := plans[buses:]:
            print("recognition")
            print_buses(few)
            print_problems(few)
            print("\nimages")
        print_plan(plans[:buses], alternatives(contract.layout, allowed))

    def sort(self, contract: Contract, bus: int, seen: Frames, load: BusLoad) -> BusLoad:
        """Return the load as it is."""
        del contract, bus, seen
        return load

    def flat(self, load: Any) -> object:
        """Return the load as it is."""
        return load

    def print_loads(self, loads: Sequence[Any]) -> None:
        """Print the loads by identifier."""
        from bandwidth.tables import print_loads

        print_loads(loads)


class OnNews:
    """Boards that send a sum when it has news."""

    def check_options(self, *, has_plot: bool, node_budget: int) -> None:  # noqa: ARG002  as of `InCycles`
        """Refuse a plot."""
        if has_plot:
            raise InputError("--plot draws cycles, and adaptive nodes send none: leave the option out")

    def plan(
        self, contract: Contract, allowed: Disturbance | None = None, *, node_budget: int = 0, is_touched: bool = True
    ) -> list[AdaptiveBusPlan]:
        """Plan all buses."""
        return plan_adaptive(contract, allowed=allowed, budget_bits_per_s=node_budget, is_touched=is_touched)

    def facts(self, contract: Contract, plans: Sequence[Any], allowed: Disturbance) -> dict[str, object]:
        """Return the way of sending."""
        del plans, allowed
        return {"sending": contract.layout.sending}

    def print_plan(self, contract: Contract, plans: Sequence[Any], allowed: Disturbance) -> None:
        """Print loads and waiting times."""
        from bandwidth.tables import print_adaptive_plan

        del contract, allowed
        print_adaptive_plan(plans)

    def sort(self, contract: Contract, bus: int, seen: Frames, load: BusLoad) -> AdaptiveLoad:
        """Return the load by kind and level."""
        return measure_adaptive(contract, bus, seen, load)

    def flat(self, load: Any) -> object:
        """Return the fields of the bus, with levels, and nodes by what their frames say."""
        fields = {field.name: getattr(load.bus, field.name) for field in dataclasses.fields(load.bus)}
        return fields | {"levels": load.levels, "nodes": load.nodes}

    def print_loads(self, loads: Sequence[Any]) -> None:
        """Print the loads by kind and level, and by node."""
        from bandwidth.tables import print_adaptive_loads

        print_adaptive_loads(loads)


def sending_of(contract: Contract) -> InCycles | OnNews:
    """Return how the boards of a skin send."""
    return OnNews() if contract.is_adaptive else InCycles()
