"""The messages that travel between the services, and the one table of their topics.

Arrays travel as little-endian bytes with the dtype named here, so that any language can read them.
Times are nanoseconds: ``*_mono_ns`` of the machine's monotonic clock (comparable between processes of
one machine), ``time_ns`` of the wall clock.
"""

from enum import IntEnum
from typing import Final

import msgspec


class Measurement(msgspec.Struct, frozen=True, kw_only=True):
    """The sums of one SYNC cycle, published by the gateway once per cycle, complete or not.

    `skin.measured_sums` checks and decodes it.

    Attributes
    ----------
    cycle : int
        SYNC cycles since the gateway started, from 1.
    sync_counter : int
        The counter byte of that SYNC on the wire, 1 to 240 (CiA 301, 7.2.5.1).
    sync_mono_ns, time_ns : int
        When the SYNC was sent.
    sums : bytes
        int32, shape (m,), in ADC counts, block by block. Sums of invalid blocks are 0.
    valid : bytes
        uint8, shape (blocks,): 1 where every sum of the block came in this very cycle.
    fingerprint : str
        The Φ the sums were measured with (`skin.measurement.Sbhe.fingerprint`).
    """

    cycle: int
    sync_counter: int
    sync_mono_ns: int
    time_ns: int
    sums: bytes
    valid: bytes
    fingerprint: str


class Image(msgspec.Struct, frozen=True, kw_only=True):
    """One reconstructed tactile image.

    Attributes
    ----------
    pixels : bytes
        float32, shape (rows, columns), newtons, never negative.
    valid : bytes
        The block validity of the measurement it was made from.
    valid_sums : int
        How many sums entered the solution.
    solve_s : float
        Time the solver took.
    published_mono_ns : int
        When the image was handed to the fabric.
    """

    cycle: int
    sync_counter: int
    sync_mono_ns: int
    published_mono_ns: int
    pixels: bytes
    valid: bytes
    valid_sums: int
    solve_s: float


#: The label of a contact that looks like no object the classifier was trained on.
UNKNOWN_OBJECT: Final = "unknown object"


class Label(msgspec.Struct, frozen=True, kw_only=True):
    """What the classifier says of one cycle.

    Attributes
    ----------
    label : str
        The object, `UNKNOWN_OBJECT`, or empty when nothing touches the skin.
    confidence : float
        0..1.
    valid_sums : int
        How many sums came in this very cycle.
    blind : bool
        Too few blocks came lately to say anything: the label is empty, but that is no "no contact".
    """

    cycle: int
    sync_counter: int
    sync_mono_ns: int
    label: str
    confidence: float
    valid_sums: int
    blind: bool = False


class Truth(msgspec.Struct, frozen=True, kw_only=True):
    """What the taxels really felt in one cycle; only a simulated or replayed skin can publish it.

    Attributes
    ----------
    step : int
        Position in the taxel source.
    true, sensor : bytes
        float32, shape (rows, columns), newtons: before and after noise, clipping and ADC.
    label : str
        The touching object, empty without contact or when unknown.
    """

    step: int
    sync_counter: int
    sync_mono_ns: int
    true: bytes
    sensor: bytes
    label: str


class FrameCounts(msgspec.Struct, kw_only=True):
    """What became of the frames that carry sums, since the gateway's start.

    Attributes
    ----------
    accepted : int
        Used for their cycle.
    late, duplicate, malformed : int
        After their cycle, a second time, and of a wrong length: never used.
    missing : int
        Awaited by a cycle and not come.
    foreign : int
        Everything else on the buses.
    """

    accepted: int = 0
    late: int = 0
    duplicate: int = 0
    malformed: int = 0
    missing: int = 0
    foreign: int = 0

    @property
    def received(self) -> int:
        """Frames with the identifier of a sums' PDO."""
        return self.accepted + self.late + self.duplicate + self.malformed


class NmtState(IntEnum):
    """NMT states as the heartbeat reports them (CiA 301, 7.2.8.3.2)."""

    INITIALISING = 0
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127


#: Stands in `BusState.nmt` for a node whose heartbeat is overdue.
SILENT: Final = 255


class BusState(msgspec.Struct, frozen=True, kw_only=True):
    """One bus as the gateway sees it.

    Attributes
    ----------
    load_ratio : float
        Bits of all frames seen in the last interval over the bits the bus could carry (exact stuffing).
    mean_load_ratio : float
        The same since SYNC started.
    nmt : bytes
        uint8 per node of the bus: last heartbeat's NMT state (CiA 301, 7.2.8.3.2), `SILENT` when that is overdue.
    missing, late : list of int
        Frames per node since the start that a cycle had to do without, and that came too late for theirs.
    emcy : list of int
        Per node the error code of its newest emergency, 0 for none (CiA 301, 7.2.7.1).
    link : str
        What the gateway's own controller says: active, warning, passive, bus_off, or lost.
    refused : list of int
        Node-IDs that are there and not used: they measure something else, or are no skin nodes.
    overrun : int
        Frames the gateway's receive buffer lost since the start.
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


class GatewayStatus(msgspec.Struct, frozen=True, kw_only=True):
    """The gateway's counters since its start, published a few times a second.

    Attributes
    ----------
    cycles, cycles_complete : int
        Cycles that have ended, and those of them in which every block was valid.
    syncs_skipped : int
        SYNCs that were not sent, because they were due too long ago.
    """

    time_ns: int
    cycles: int
    cycles_complete: int
    frames: FrameCounts
    sync_rate_hz: float
    buses: list[BusState]
    syncs_skipped: int = 0


class NodesStatus(msgspec.Struct, frozen=True, kw_only=True):
    """Counters of one process of virtual nodes."""

    time_ns: int
    process: str
    frames_sent: int
    frames_dropped: int
    syncs_seen: int


class Topic(msgspec.Struct, frozen=True):
    """One kind of message and the name it travels under."""

    name: str
    message: type[msgspec.Struct]


MEASUREMENT: Final = Topic("measurement", Measurement)
IMAGE: Final = Topic("image", Image)
LABEL: Final = Topic("label", Label)
TRUTH: Final = Topic("truth", Truth)
GATEWAY: Final = Topic("gateway", GatewayStatus)
NODES: Final = Topic("nodes", NodesStatus)
