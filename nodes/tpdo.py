"""A transmit PDO as its records describe it now (CiA 301, 7.2.2), and when the PDO is due."""

from collections.abc import Iterable
from dataclasses import dataclass, field

from canopen import SdoAbortedError

from dbc import indices as od
from dbc.canopen import BASE_ID_MASK, COB_ID_INVALID, EVENT_MANUFACTURER, LAST_SYNCHRONOUS
from dbc.frame import FD_LENGTHS
from nodes.objects import LocalNode
from skin.sync_counter import SYNC_OVERFLOW


@dataclass
class LiveTpdo:
    """A transmit PDO as the object dictionary of a running node has it now.

    Attributes
    ----------
    every : int
        Transmission type: 0 acyclic synchronous, n = 1 to 240 every n-th SYNC, 254 and 255 event-driven.
    start : int
        SYNC start value; with 0 the node counts SYNCs from the first.
    inhibit_s, event_s : float
        Inhibit time and event timer, of event-driven PDOs only; 0 for none.
    mapped : list of (int, int, int)
        Index, sub-index and bits of each mapped object, in the order of the bits.
    length : int
        Payload in bytes, with the padding of CAN FD.
    """

    cob_id: int
    every: int
    start: int
    inhibit_s: float
    event_s: float
    mapped: list[tuple[int, int, int]]
    length: int
    _syncs: int = 0
    _last: bytes | None = None
    _sent_at_s: float = field(default=float("-inf"))

    @property
    def is_plain(self) -> bool:
        """Whether the PDO is cyclic and carries the SYNC counter and then sums only, so that `Burst` can send it."""
        indices = [od.split_block(index)[1] for index, _, _ in self.mapped]
        is_plain = indices[0] == od.SYNC_COUNTER and set(indices[1:]) == {od.SUMS}
        return 1 <= self.every <= LAST_SYNCHRONOUS and is_plain

    def payload(self, node: LocalNode) -> bytes:
        """Return the bytes to send now."""
        packed = shift = 0
        for index, subindex, bits in self.mapped:
            value = int.from_bytes(node.get_data(index, subindex), "little")
            packed |= (value & (1 << bits) - 1) << shift
            shift += bits
        return packed.to_bytes(self.length, "little")

    def at_sync(self, counter: int, node: LocalNode) -> bytes | None:
        """Return the payload if the PDO is due at SYNC `counter`, else None."""
        self._syncs += 1
        if self.every > LAST_SYNCHRONOUS or not is_turn(self.every or 1, self.start, counter, self._syncs):
            return None
        payload = self.payload(node)
        if self.every == 0 and payload == self._last:
            return None
        self._last = payload
        return payload

    def at_event(self, now_s: float, node: LocalNode) -> bytes | None:
        """Return the payload of an event-driven PDO if it has changed or the event timer has expired, else None."""
        if self.every < EVENT_MANUFACTURER or now_s < self._sent_at_s + self.inhibit_s:
            return None
        payload = self.payload(node)
        overdue = self.event_s and now_s >= self._sent_at_s + self.event_s
        if payload == self._last and not overdue:
            return None
        self._last, self._sent_at_s = payload, now_s
        return payload


def is_turn(every: int, start: int, counter: int, syncs: int) -> bool:
    """Tell whether a cyclic PDO is due at a SYNC.

    With a SYNC start value the counter of the SYNC decides, not the number of SYNCs received. So a missed SYNC does
    not shift later transmissions.
    """
    if start and counter:
        return (counter - start) % SYNC_OVERFLOW % every == 0
    return syncs % every == 0


def read_tpdos(node: LocalNode, numbers: Iterable[int]) -> list[LiveTpdo]:
    """Read the existing TPDOs of these numbers; a TPDO with an unreadable mapping does not exist."""
    found = []
    for number in numbers:
        try:
            tpdo = _read(node, od.TPDO_COMMUNICATION + number - 1, od.TPDO_MAPPING + number - 1)
        except SdoAbortedError:
            continue
        if tpdo is not None:
            found.append(tpdo)
    return found


def _read(node: LocalNode, communication: int, mapping: int) -> LiveTpdo | None:
    cob_id = node.unsigned(communication, 1)
    entries = [node.unsigned(mapping, place) for place in range(1, node.unsigned(mapping, 0) + 1)]
    length = (sum(entry & 0xFF for entry in entries) + 7) // 8
    if cob_id & COB_ID_INVALID or not entries or length > node.pdo_bytes:
        return None
    if any(node.mappable_bits(entry >> 16, entry >> 8 & 0xFF) != entry & 0xFF for entry in entries):
        return None
    return LiveTpdo(
        cob_id=cob_id & BASE_ID_MASK,
        every=node.unsigned(communication, 2),
        start=node.unsigned(communication, 6),
        inhibit_s=node.unsigned(communication, 3) * 1e-4,
        event_s=node.unsigned(communication, 5) * 1e-3,
        mapped=[(entry >> 16, entry >> 8 & 0xFF, entry & 0xFF) for entry in entries],
        length=next(each for each in FD_LENGTHS if each >= length),  # up to 8 bytes every length has its DLC
    )
