"""The wires' part of a snapshot: what the gateway and the processes of nodes count."""

from typing import Final

from skin.messages import BusState, GatewayStatus, NodesStatus
from viewer.snapshot import BusView, GatewayState, NodesState

#: What a gateway's controller says when it can neither send nor receive.
DEAD_LINKS: Final = ("lost", "bus_off")
#: The gateway's word for the NMT state of a node it does not hear.
SILENT: Final = 255


def gateway_state(status: GatewayStatus, age_s: float, *, stale: bool) -> GatewayState:
    """Return what the page shows of the gateway's counters."""
    return GatewayState(
        age_s=age_s,
        stale=stale,
        sync_rate_hz=status.sync_rate_hz,
        cycles=status.cycles,
        cycles_complete=status.cycles_complete,
        frames_received=status.frames_received,
        frames_missing=status.frames_missing,
        frames_late=status.frames_late,
        frames_duplicate=status.frames_duplicate,
        frames_malformed=status.frames_malformed,
        frames_foreign=status.frames_foreign,
        buses=[_bus_view(bus, place, status.mean_load_ratio) for place, bus in enumerate(status.buses)],
    )


def nodes_state(status: NodesStatus, age_s: float, *, stale: bool) -> NodesState:
    """Return what the page shows of one process of nodes."""
    return NodesState(
        process=status.process,
        age_s=age_s,
        stale=stale,
        frames_sent=status.frames_sent,
        frames_dropped=status.frames_dropped,
    )


def _bus_view(bus: BusState, place: int, mean_load_ratio: list[float]) -> BusView:
    return BusView(
        name=bus.name,
        load_ratio=bus.load_ratio,
        mean_load_ratio=mean_load_ratio[place] if place < len(mean_load_ratio) else None,
        nodes=bus.nodes,
        nmt=list(bus.nmt),
        refused=bus.refused,
        link=bus.link,
        dead=bus.link in DEAD_LINKS,
        synced=bus.link not in DEAD_LINKS and not (bus.link == "passive" and set(bus.nmt) == {SILENT}),
    )
