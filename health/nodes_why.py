"""Since when a node or the gateway's host is not whole, and why, from the gateway's counters."""

from collections import defaultdict
from collections.abc import Mapping
from typing import Final, NamedTuple

from canskin.messages import LINK_CODES, REFUSED_CODE, SILENT, BusState, Fault, GatewayStatus, NmtState, NodeFault
from health.causes import Cause
from health.snapshot import DEAD_LINKS, NodeTrouble

#: Names of the NMT states on the page (CiA 301, 7.2.8.3.2).
NMT_WORDS: Final[dict[int, str]] = {
    NmtState.INITIALISING: "booting",
    NmtState.STOPPED: "stopped",
    NmtState.OPERATIONAL: "operational",
    NmtState.PRE_OPERATIONAL: "pre-operational",
    SILENT: "silent",
}
#: A node loses frames until none has been missing for this time, that of `health.state.SPAN_S`.
LOSS_S: Final = 1.0
#: A node is late whose answers or heartbeats take this part of the time that they have.
LATE_RATIO: Final = 0.9
#: By why the gateway does not use a node: words for several nodes.
_FAULTS: Final = {
    Fault.ABSENT: "never heard",
    Fault.AWAY: "optional, not there",
    Fault.SILENT: "silent",
    Fault.OTHER_DEVICE: "refused by the gateway: another device",
    Fault.REFUSED: "refused by the gateway: not of this skin",
    Fault.UNANSWERED: "without answer to SDO requests",
    Fault.LEFT: "no longer operational",
    Fault.BOOTED: "booted again",
    Fault.CHANGED: "doubted",
    Fault.UNPROVEN: "not proven for too long",
    Fault.TWICE: "there twice",
    Fault.STARTING: "not proven yet",
    Fault.FROZEN: "frozen",
}
#: Troubles beside which missing frames are counted.
_OF_USED: Final = (Cause.NODE_LOSES, Cause.NODE_EMERGENCY)
#: Of these nodes the NMT state tells more.
_BY_STATE: Final = (Fault.LEFT, Fault.BOOTED, Fault.STARTING)


class Trouble(NamedTuple):
    """Why a node is not whole: the cause, words that several nodes share, and what was seen of this node."""

    cause: Cause
    word: str
    evidence: str = ""

    def of_node(self, node: int, since_time_s: float) -> NodeTrouble:
        """Return this trouble as that of a node."""
        return NodeTrouble(node, since_time_s, self.evidence or self.word, self.cause.code, self.word)


def _trouble(status: GatewayStatus, bus: BusState, place: int, *, loses: bool) -> Trouble | None:
    """Return what is wrong with the node at a place of a bus, the gravest alone; None if all is well."""
    if bus.link in DEAD_LINKS:
        return Trouble(Cause.of(LINK_CODES[bus.link]), "its bus is down")
    node, nmt = bus.nodes[place], bus.nmt[place]
    code = bus.emcy[place] if place < len(bus.emcy) else 0
    emergency = f"EMCY {code:04X}h" if code else ""
    if (fault := _fault(bus, node, nmt)) is not None:
        return trouble_of(fault, nmt, emergency)
    if loses:
        words = "frames with sums are missing"
        return Trouble(Cause.NODE_LOSES, words, ", ".join(filter(None, (words, emergency))))
    if emergency:
        return Trouble(Cause.NODE_EMERGENCY, emergency)
    late = _late(status, bus, place)
    return Trouble(Cause.NODE_LATE, "late", late) if late else None


def trouble_of(fault: NodeFault, nmt: int, emergency: str = "") -> Trouble:
    """Return what is wrong with a node of this NMT state whose sums cannot be used."""
    word = _FAULTS[fault.kind]
    if fault.kind in _BY_STATE and nmt != NmtState.OPERATIONAL:
        word = NMT_WORDS.get(nmt, word)
    return Trouble(Cause.of(fault.code), word, ", ".join(filter(None, (fault.words or word, emergency))))


def _fault(bus: BusState, node: int, nmt: int) -> NodeFault | None:
    """Return why a node is not used; what gateways of before do not tell is concluded from its NMT state."""
    if bus.faults:
        return bus.faults.get(node)
    if nmt == SILENT:
        return NodeFault(Fault.SILENT)
    if node in bus.refused:
        return NodeFault(Fault.REFUSED)
    return None if nmt == NmtState.OPERATIONAL else NodeFault(Fault.STARTING)


def _late(status: GatewayStatus, bus: BusState, place: int) -> str:
    """Tell how late a node answers, empty if it is in time."""
    for name, spreads, limit_s in (
        ("answers to SDO requests", bus.answer_s, status.answer_limit_s),
        ("heartbeats", bus.heartbeat_s, status.heartbeat_limit_s),
    ):
        least_s, longest_s = spreads[place] if place < len(spreads) else (0.0, 0.0)
        if limit_s and longest_s > LATE_RATIO * limit_s:
            return f"{name} after {1e3 * least_s:.0f} ms to {1e3 * longest_s:.0f} ms"
    return ""


def link_cause(bus: BusState) -> Cause | None:
    """Return what is wrong with the gateway's link to a bus; None if nothing is."""
    is_well = bus.link not in LINK_CODES and not bus.trouble
    return None if is_well else Cause.of(LINK_CODES.get(bus.link, REFUSED_CODE))


class Troubles:
    """Notes when each node, and the gateway's host, got its trouble. Times are those of the caller's clock."""

    def __init__(self) -> None:
        self._troubles: dict[str, dict[int, tuple[Trouble, float]]] = {}
        #: By what is counted, of whom: the count so far, and when it last grew.
        self._counted: dict[tuple[str, ...], tuple[int, float]] = {}
        self._late: tuple[str, float] | None = None

    def take(self, status: GatewayStatus, now_s: float) -> None:
        """Take the next counters."""
        before, self._troubles = self._troubles, defaultdict(dict)
        counted, self._counted = self._counted, {}
        for bus in status.buses:
            known = before.get(bus.name, {})
            for place, node in enumerate(bus.nodes):
                missing = bus.missing[place] if bus.missing else 0
                loses = self._grows(counted, ("missing", bus.name, str(node)), missing, now_s)
                trouble = _trouble(status, bus, place, loses=loses)
                if trouble is not None and trouble.cause not in _OF_USED:  # frames are missing because of that
                    del self._counted["missing", bus.name, str(node)]
                if trouble is not None:
                    old, since_s = known.get(node, (trouble, now_s - bus.out_s.get(node, 0.0)))
                    self._troubles[bus.name][node] = trouble, since_s if old[:2] == trouble[:2] else now_s

        words = ", ".join(
            f"{count} {name}"
            for name, count in (
                ("SYNCs not sent", status.syncs_skipped),
                ("frames lost in its receive buffers", sum(bus.overrun for bus in status.buses)),
            )
            if self._grows(counted, (name,), count, now_s)
        )
        self._late = (words, self._late[1] if self._late else now_s) if words else None

    def late(self, epoch_s: float) -> tuple[str, float | None]:
        """Return what the gateway's host has left out lately, and since when."""
        return ("", None) if self._late is None else (self._late[0], epoch_s + self._late[1])

    def of(self, epoch_s: float) -> dict[str, list[NodeTrouble]]:
        """Return the troubles by bus; `epoch_s` is the wall-clock time of 0."""
        return {
            bus: [trouble.of_node(node, epoch_s + since_s) for node, (trouble, since_s) in nodes.items()]
            for bus, nodes in self._troubles.items()
        }

    def _grows(
        self, counted: Mapping[tuple[str, ...], tuple[int, float]], key: tuple[str, ...], count: int, now_s: float
    ) -> bool:
        before, last_s = counted.get(key, (count, -LOSS_S))
        if count > before:
            last_s = now_s
        self._counted[key] = count, last_s
        return now_s - last_s < LOSS_S
