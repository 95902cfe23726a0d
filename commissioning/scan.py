"""Who is on a CAN bus: identifiers with their rates, CANopen nodes, their identities and states; whatever the layout.

A node is known by its heartbeat, its EMCY or its SDO responses. Then every node-ID is asked for its identity by SDO
uploads, so slowly that requests and responses take `ASKED_LOAD` of the bus at most.
"""

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from bus.link import Send
from dbc import indices as od
from dbc.canopen import (
    EMCY_BASE,
    EMCY_BYTES,
    EXTENDED_ID_MASK,
    HEARTBEAT_BASE,
    HEARTBEAT_BYTES,
    HIGHEST_NODE_ID,
    NMT_COB_ID,
    SDO_BYTES,
    SDO_REQUEST_BASE,
    SDO_RESPONSE_BASE,
    SERVICES,
    SYNC_COB_ID,
    TIME_COB_ID,
    TPDO_BASES,
    state_text,
)
from dbc.frame import ECHO, ERROR, EXTENDED, REMOTE, Frames, frames, one_frame
from dbc.frame_bits import wire_bits
from dbc.values import decode
from gateway.questions import Questions
from gateway.sdo import Dialogue, Read, SdoError
from gateway.strangers import produces_sync

#: Part of the bus that requests and responses take.
ASKED_LOAD: Final = 0.05
#: What is read of each node, the rest if it answers to 1000h: key of `ScannedNode`, index, sub-index, data type.
_ASKED: Final = (
    ("device_type", od.DEVICE_TYPE, 0, od.UNSIGNED32),
    ("vendor_id", od.IDENTITY, 1, od.UNSIGNED32),
    ("product_code", od.IDENTITY, 2, od.UNSIGNED32),
    ("revision", od.IDENTITY, 3, od.UNSIGNED32),
    ("serial_number", od.IDENTITY, 4, od.UNSIGNED32),
    ("sync_cob_id", od.SYNC_COB_ID, 0, od.UNSIGNED32),
    ("device_name", od.DEVICE_NAME, 0, od.VISIBLE_STRING),
)
#: Predefined connection set (CiA 301, 7.3.5).
_OF_ALL: Final = {NMT_COB_ID: "NMT", SYNC_COB_ID: "SYNC", TIME_COB_ID: "TIME"}
_OF_NODE: Final = {
    **SERVICES,
    **{base: f"TPDO {number}" for number, base in enumerate(TPDO_BASES[:4], 1)},
    **{base: f"RPDO {number}" for number, base in enumerate(TPDO_BASES[4:], 1)},
}


@dataclass
class ScannedNode:
    """One CANopen node; None for what it did not tell. `state` is that of its newest heartbeat.

    `is_busy` tells that other masters used its SDO channel all the time, so that it was not asked; `refusal` why the
    last of the objects that it did not tell is missing.
    """

    node_id: int
    heard: list[str] = field(default_factory=list)
    state: str | None = None
    device_type: int | None = None
    device_name: str | None = None
    vendor_id: int | None = None
    product_code: int | None = None
    revision: int | None = None
    serial_number: int | None = None
    sync_cob_id: int | None = None
    is_busy: bool = False
    refusal: str = ""

    @property
    def produces_sync(self) -> bool:
        """Whether the node says that it sends SYNC with identifier 080h."""
        return produces_sync(self.sync_cob_id or 0)


@dataclass(frozen=True)
class ScannedIdentifier:
    """One identifier: number and rate of its frames, and their longest payload, bytes."""

    cob_id: int
    is_extended: bool
    frames: int
    rate_hz: float
    length: int

    @property
    def meaning(self) -> str:
        """What the predefined connection set (CiA 301, 7.3.5) has the identifier for; a device may use others."""
        if self.is_extended:
            return "29 bits"
        if self.cob_id in _OF_ALL:
            return _OF_ALL[self.cob_id]
        kind, node_id = _OF_NODE.get(self.cob_id & ~HIGHEST_NODE_ID), self.cob_id & HIGHEST_NODE_ID
        return f"{kind} of {node_id}" if kind and node_id else "-"


class Scan:
    """The scan of one bus: frames and times in, requests out.

    Parameters
    ----------
    listen_s : float
        Time of listening, before the first request.
    asks : bool
        Whether node-IDs are asked; else the scan sends nothing.

    Attributes
    ----------
    done : bool
    nodes : dict of int to ScannedNode
        By node-ID.
    """

    def __init__(self, send: Send, bitrate: int, now_s: float, *, listen_s: float, asks: bool = True) -> None:
        self._send = send
        #: Shortest time from one request to the next: a request and a response with the most stuff bits.
        longest = one_frame(SDO_REQUEST_BASE, bytes(SDO_BYTES))
        self._pause_s = 2 * int(wire_bits(longest, "worst")[0][0]) / (ASKED_LOAD * bitrate)
        self._listen_s, self._started_s = listen_s, now_s
        self.due_s = now_s + listen_s
        self.done = False
        self.nodes: dict[int, ScannedNode] = {}
        self._heard: list[Frames] = []
        self._questions = Questions(self._ask, self._send_one)
        if asks:
            self._questions.ask(range(1, HIGHEST_NODE_ID + 1))

    def take(self, arrived: Frames, now_s: float) -> None:
        """Use received frames, in bus order."""
        if self.done:
            return
        plain = arrived[arrived["flags"] & (ERROR | REMOTE | ECHO) == 0]
        if now_s <= self._started_s + self._listen_s:
            self._heard.append(plain)
        base = plain[(plain["flags"] & EXTENDED == 0) & (plain["can_id"] & HIGHEST_NODE_ID != 0)]
        for each in base[base["can_id"] >= EMCY_BASE]:
            can_id, data = int(each["can_id"]), each["data"][: each["length"]].tobytes()
            self._take(can_id & ~HIGHEST_NODE_ID, can_id & HIGHEST_NODE_ID, data, now_s)

    def _take(self, base: int, node_id: int, data: bytes, now_s: float) -> None:
        if base == HEARTBEAT_BASE and len(data) == HEARTBEAT_BYTES:
            self._node(node_id, "heartbeat").state = state_text(data[0] & 0x7F)
        elif base == EMCY_BASE and len(data) == EMCY_BYTES:
            self._node(node_id, "EMCY")
        elif base == SDO_RESPONSE_BASE and len(data) == SDO_BYTES:
            self._node(node_id, "SDO")
        self._questions.take(base, node_id, data, now_s)

    def _node(self, node_id: int, how: str) -> ScannedNode:
        node = self.nodes.setdefault(node_id, ScannedNode(node_id))
        if how not in node.heard:
            node.heard.append(how)
        return node

    def tick(self, now_s: float) -> None:
        """Go on with the dialogues, and begin the next."""
        self._questions.tick(now_s)
        if now_s < self.due_s:
            return
        self._questions.begin(now_s)
        self.due_s = max(self.due_s, now_s + self._pause_s)
        for node_id in self._questions.busy:
            self._node(node_id, "SDO").is_busy = True
        self.done = self._questions.done

    def stop(self, now_s: float) -> None:
        """End the scan before it is done."""
        self._listen_s, self.done = min(self._listen_s, now_s - self._started_s), True

    def _ask(self, node_id: int) -> Dialogue:
        for key, index, subindex, data_type in _ASKED:
            try:
                value = yield Read(index, subindex, data_type)
            except SdoError as error:
                if node_id in self.nodes:
                    self.nodes[node_id].refusal = str(error)
                if index == od.DEVICE_TYPE:
                    break
            else:
                setattr(self._node(node_id, "SDO"), key, decode(data_type, value))
        return None

    def _send_one(self, can_id: int, data: bytes) -> None:
        self.due_s += self._pause_s
        self._send(one_frame(can_id, data))

    @property
    def identifiers(self) -> list[ScannedIdentifier]:
        """The identifiers that came while the scan listened, by number."""
        seen = np.concatenate([frames(0), *self._heard])
        keys = seen["can_id"].astype(np.int64) | (seen["flags"] & EXTENDED != 0).astype(np.int64) << 32
        return [
            ScannedIdentifier(
                cob_id=int(key & EXTENDED_ID_MASK),
                is_extended=bool(key >> 32),
                frames=int(count),
                rate_hz=float(count) / self._listen_s,
                length=int(seen["length"][keys == key].max()),
            )
            for key, count in zip(*np.unique(keys, return_counts=True), strict=True)
        ]

    @property
    def sync_rate_hz(self) -> float:
        """SYNCs in a second, 0 without SYNC."""
        found = {each.cob_id: each.rate_hz for each in self.identifiers if not each.is_extended}
        return found.get(SYNC_COB_ID, 0.0)
