"""Buses and nodes in a snapshot, from the counters of the gateway and of the processes of nodes."""

from typing import Final

import msgspec

from canskin.messages import SILENT, BusState, GatewayStatus, NodesStatus
from viewer.snapshot import BusView, GatewayState, NodesState

#: States of the gateway's controller in which it neither sends nor receives.
DEAD_LINKS: Final = ("lost", "bus_off")


def gateway_state(status: GatewayStatus, age_s: float, *, stale: bool) -> GatewayState:
    """Return the gateway's counters as the page shows them."""
    buses = list(map(_bus_view, status.buses))
    zero = status.calibration.zero_words if status.calibration else ""
    more = {"age_s": age_s, "stale": stale, "buses": buses, "zero": zero}
    return GatewayState(**{**msgspec.structs.asdict(status), **more})


def nodes_state(status: NodesStatus, age_s: float, *, stale: bool) -> NodesState:
    """Return the counters of one process of nodes as the page shows them."""
    return NodesState(**{**msgspec.structs.asdict(status), "age_s": age_s, "stale": stale})


def _bus_view(bus: BusState) -> BusView:
    is_dead = bus.link in DEAD_LINKS
    more = {
        "nmt": list(bus.nmt),
        "dead": is_dead,
        "synced": not is_dead and not (bus.link == "passive" and set(bus.nmt) == {SILENT}),
    }
    return BusView(**{**msgspec.structs.asdict(bus), **more})
