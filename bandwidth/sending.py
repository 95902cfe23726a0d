"""What the way of sending decides of plans and loads: boards that send in every cycle, or when they have news."""

from collections.abc import Mapping, Sequence
from typing import Any

from bandwidth.adaptive_log import measure_adaptive
from bandwidth.adaptive_plan import AdaptiveBusPlan, plan_adaptive
from bandwidth.alternatives import alternatives
from bandwidth.measured import Measured
from bandwidth.plan import BusPlan, plan
from bandwidth.traffic import Disturbance
from dbc.contract import Contract
from dbc.packing import rounding_error_n
from shell.terminal import print_json


class InCycles:
    """Boards that send all their sums after every SYNC."""

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

    def print_loads(self, contract: Contract, parts: Mapping[int, Sequence[Measured]], *, as_json: bool) -> None:
        """Print the loads by identifier; `parts` are by number of the bus."""
        from bandwidth.tables import print_loads

        del contract
        found = [each.load for of_bus in parts.values() for each in of_bus]
        print_json({"buses": found}) if as_json else print_loads(found)


class OnNews:
    """Boards that send a sum when it has news."""

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

    def print_loads(self, contract: Contract, parts: Mapping[int, Sequence[Measured]], *, as_json: bool) -> None:
        """Print the loads by kind and level, and by node."""
        from bandwidth.tables import print_adaptive_loads

        found = [
            measure_adaptive(contract, number, each.frames, each.load)
            for number, of_bus in parts.items()
            for each in of_bus
        ]
        if not as_json:
            print_adaptive_loads(found)
            return
        print_json({"buses": [vars(each.bus) | {"levels": each.levels, "nodes": each.nodes} for each in found]})


def sending_of(contract: Contract) -> InCycles | OnNews:
    """Return how the boards of a skin send."""
    return OnNews() if contract.is_adaptive else InCycles()
