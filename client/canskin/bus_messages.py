"""Counters and states of the buses, parts of `canskin.messages.GatewayStatus`."""

from enum import IntEnum
from typing import Final

import msgspec


class FrameCounts(msgspec.Struct, kw_only=True):
    """Numbers of frames since the gateway's start, by what the collector did with them.

    Attributes
    ----------
    accepted : int
        Frames with sums that were used.
    late, duplicate, malformed : int
        Frames with sums that came after their cycle, came twice, or had a wrong length; they are not used.
    unrefined, unproven : int
        Adaptive: fine frames whose coarse frame is not held, and frames of nodes that are not proven; not used.
    missing : int
        Frames with sums that did not come in their cycle.
    foreign : int
        All other frames on the buses.
    """

    accepted: int = 0
    late: int = 0
    duplicate: int = 0
    malformed: int = 0
    missing: int = 0
    foreign: int = 0
    unrefined: int = 0
    unproven: int = 0

    @property
    def received(self) -> int:
        """Number of frames with the identifier of a TPDO with sums."""
        return self.accepted + self.late + self.duplicate + self.malformed + self.unrefined + self.unproven


class NmtState(IntEnum):
    """NMT states in the heartbeat (CiA 301, 7.2.8.3.2)."""

    INITIALISING = 0
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127


#: Value in `BusState.nmt` of a node whose heartbeat is overdue.
SILENT: Final = 255


class BusState(msgspec.Struct, frozen=True, kw_only=True):
    """State of one bus, from the gateway.

    Attributes
    ----------
    load_ratio : float
        Bus load since the last status: time of all frames (exact stuffing) / time that passed.
    mean_load_ratio : float
        Bus load since SYNC started.
    nmt : bytes
        uint8 per node of the bus: NMT state in the last heartbeat (CiA 301, 7.2.8.3.2), `SILENT` when it is overdue.
    missing, late : list of int
        Number of frames per node since the start that did not come in their cycle, and that came too late.
    emcy : list of int
        Error code of each node's newest emergency, 0 for none (CiA 301, 7.2.7.1).
    link : str
        State of the gateway's controller: active, warning, passive, bus_off, or lost.
    refused : list of int
        Node-IDs that answer but are not used: their configuration differs from the contract.
    overrun : int
        Number of frames that the gateway's receive buffer lost since the start.
    """

    name: str
    load_ratio: float
    mean_load_ratio: float = 0.0
    nodes: list[int]
    nmt: bytes
    missing: list[int] = []
    late: list[int] = []
    emcy: list[int] = []
    refused: list[int] = []
    link: str = "active"
    overrun: int = 0
