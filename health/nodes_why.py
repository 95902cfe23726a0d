"""Since when a node is not whole, and why, from the gateway's counters."""

from collections import defaultdict
from collections.abc import Mapping
from typing import Final

from canskin.messages import SILENT, BusState, GatewayStatus, NmtState
from health.snapshot import DEAD_LINKS, NodeTrouble

#: Names of the NMT states on the page (CiA 301, 7.2.8.3.2).
NMT_WORDS: Final[dict[int, str]] = {
    NmtState.INITIALISING: "booting",
    NmtState.STOPPED: "stopped",
    NmtState.OPERATIONAL: "operational",
    NmtState.PRE_OPERATIONAL: "pre-operational",
    SILENT: "silent",
}
REFUSED: Final = "refused by the gateway: not of this skin"
#: A node loses frames until none has been missing for this time, that of `health.state.SPAN_S`.
LOSS_S: Final = 1.0
#: Emergencies from this code on are of the device (CiA 301, 7.2.7.1): that it missed its window once, whose end no node
#: tells. They explain frames that are missing now, and are no trouble without.
DEVICE_EMCY: Final = 0xFF00


def word_of(bus: BusState, node: int, nmt: int) -> str:
    """Return why a node sends no sums; empty for an operational one."""
    if node in bus.refused and nmt != SILENT:
        return REFUSED
    return "" if nmt == NmtState.OPERATIONAL else NMT_WORDS.get(nmt, "")


class NodeTroubles:
    """Notes when each node got its trouble. Times are those of the caller's clock."""

    def __init__(self) -> None:
        self._troubles: dict[str, dict[int, tuple[str, float]]] = {}
        #: Of each bus and node: frames missing so far, and when the last of them was.
        self._missing: dict[tuple[str, int], tuple[int, float]] = {}

    def take(self, status: GatewayStatus, now_s: float) -> None:
        """Take the next counters."""
        before, self._troubles = self._troubles, defaultdict(dict)
        missed, self._missing = self._missing, {}
        for bus in status.buses:
            known = before.get(bus.name, {})
            emergencies = dict(zip(bus.nodes, bus.emcy, strict=False))
            missing = dict(zip(bus.nodes, bus.missing, strict=False))
            for node, nmt in zip(bus.nodes, bus.nmt, strict=True):
                loses = self._loses(missed, (bus.name, node), missing.get(node, 0), now_s)
                why = "its bus is down" if bus.link in DEAD_LINKS else word_of(bus, node, nmt)
                if not why and loses:
                    why = "frames with sums are missing"
                code = emergencies.get(node, 0)
                if code and (why or code < DEVICE_EMCY):
                    why = f"{why}, EMCY {code:04X}h" if why else f"EMCY {code:04X}h"
                if why:
                    word, since_s = known.get(node, ("", now_s))
                    self._troubles[bus.name][node] = why, since_s if word == why else now_s

    def of(self, epoch_s: float) -> dict[str, list[NodeTrouble]]:
        """Return the troubles by bus; `epoch_s` is the wall-clock time of 0."""
        return {
            bus: [NodeTrouble(node, epoch_s + since_s, why) for node, (why, since_s) in nodes.items()]
            for bus, nodes in self._troubles.items()
        }

    def _loses(
        self, missed: Mapping[tuple[str, int], tuple[int, float]], key: tuple[str, int], missing: int, now_s: float
    ) -> bool:
        before, last_s = missed.get(key, (missing, -LOSS_S))
        if missing > before:
            last_s = now_s
        self._missing[key] = missing, last_s
        return now_s - last_s < LOSS_S
