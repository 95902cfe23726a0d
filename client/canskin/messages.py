"""The messages between the services, and the table of their topics.

Arrays are little-endian bytes of the dtype named here, so programs in any language can read them.
Times are nanoseconds: ``*_mono_ns`` of the machine's monotonic clock, ``time_ns`` of the wall clock.

``sampled_mono_ns`` is the instant at which the boards sampled the taxels: with synchronous sending the end of the SYNC
on the bus. Messages that follow from a measurement carry its `sampled_mono_ns` and `sampled_error_ns`.
"""

from collections.abc import Callable
from enum import Enum, IntEnum
from typing import Any, Final

import msgspec

from canskin.calibration_messages import CalibrationStatus
from canskin.errors import InputError
from canskin.text import Told

#: `sampled_error_ns` of a sampling instant whose error has no proven bound.
UNKNOWN_ERROR_NS: Final = -1


class BlockState(IntEnum):
    """How a stepped block's sums stand."""

    #: The node is not operational, not proven, or silent for too long. Nothing is known.
    DEAD = 0
    #: A value is held, and may be old: a frame was lost, or came late.
    STALE = 1
    #: No frame came lately, because nothing changed: the node is alive.
    QUIET = 2
    #: A frame came lately.
    FRESH = 3


class Measurement(Told, frozen=True, kw_only=True):
    """The newest sums of a skin: a `CycleMeasurement` or a `SteppedMeasurement`, with what both tell.

    `skin.measured_sums` checks and decodes a measurement.

    Attributes
    ----------
    cycle : int
        Number of the measurement since the gateway started, from 1.
    sync_counter : int
        Counter of the newest SYNC, 1 to 240 (CiA 301, 7.2.5.1), also where SYNC has no counter on the bus.
    sampled_mono_ns : int
        Sampling instant: when the SYNC ended on the bus, a mean over the buses. Stepped: when the newest frame ended
        that is in the sums; its sample is older, by at most `sampled_error_ns`.
    sampled_error_ns : int
        Bound of the difference between `sampled_mono_ns` and the sampling instant of any bus whose SYNC was seen, see
        `gateway.sync_times`; `UNKNOWN_ERROR_NS` if no bound is proven.
    wall_offset_ns : int
        Wall clock minus monotonic clock.
    bus_sampled_ns : bytes
        int64, shape (buses,): the sampling instant of each bus, on the monotonic clock; 0 if the SYNC was not seen.
        Stepped: when the newest frame of each bus ended that is in the sums; 0 before the first.
    sums : bytes
        int32, shape (m,), in ADC counts, block by block, in the order of Φ. Sums of invalid blocks are 0; stepped:
        unknown sums are 0.
    valid : bytes
        uint8, shape (blocks,): 1 if every sum of the block came in this cycle and its node is proven; stepped: if the
        block is fresh or quiet, and all its sums are known. Always 0 for a block that sends no sums.
    fingerprint : str
        Fingerprint of the Φ of the sums (`skin.phi.Sbhe.fingerprint`).
    offsets : bytes
        int32, shape (m,), ADC counts: what an untouched skin reads. Empty if unknown; stepped: if nothing is settled.
    usable : bytes
        uint8, shape (m,): 0 for sums that are defective, or have no offset while others have. Empty if all are 1.
    doubtful : bytes
        Bits of `numpy.packbits`, row-major, shape (ceil(n / 8),): 1 for taxels whose force may be an error of the zero,
        for example of a warm patch, or of gains that nobody has accepted. Empty if no taxel is doubtful.
        `canskin.sums.doubtful_taxels` decodes them.
    duty : str
        ``SERVICE=INSTANCE``, a space between two: the instance of each service (`canskin.peers.Peer`) that publishes
        what it makes of this measurement. Other instances stand by. Services that are not named here all publish.
    """

    cycle: int
    sync_counter: int
    sampled_mono_ns: int
    sums: bytes
    valid: bytes
    fingerprint: str
    offsets: bytes = b""
    usable: bytes = b""
    doubtful: bytes = b""
    sampled_error_ns: int = UNKNOWN_ERROR_NS
    wall_offset_ns: int = 0
    bus_sampled_ns: bytes = b""
    duty: str = ""

    def names(self, service: str, instance: str) -> bool:
        """Tell whether an instance of a service publishes what it makes of this measurement."""
        return f"{service}={instance}" in self.duty.split() or f"{service}=" not in self.duty

    @property
    def time_ns(self) -> int:
        """The sampling instant on the wall clock."""
        return self.sampled_mono_ns + self.wall_offset_ns


class CycleMeasurement(Measurement, frozen=True, kw_only=True, tag_field="sending", tag="synchronous"):
    """The sums of one SYNC cycle; the gateway publishes one measurement per cycle, complete or not.

    Attributes
    ----------
    sent_mono_ns : int
        The sampling instant without time stamps: time of the send call + time of SYNC; 0 if unknown.
    """

    sent_mono_ns: int = 0


class SteppedMeasurement(Measurement, frozen=True, kw_only=True, tag_field="sending", tag="steps"):
    """The newest value of every sum; the gateway publishes when frames have come, and at a least rate.

    Attributes
    ----------
    known : bytes
        uint8, shape (m,), 1 if a value of the sum is held.
    states : bytes
        uint8, shape (blocks,): `BlockState`.
    since_ns : bytes
        int64, shape (blocks,): monotonic time since when the block is in its state.
    noise_n : float
        Median of the nodes' noise, newtons; 0 if it is not known.
    """

    known: bytes
    states: bytes
    since_ns: bytes
    noise_n: float = 0.0


class Image(msgspec.Struct, frozen=True, kw_only=True):
    """One reconstructed tactile image.

    Attributes
    ----------
    pixels : bytes
        float32, shape (rows, columns), newtons, never negative.
    valid : bytes
        uint8, shape (blocks,): 1 if the block came in this cycle, and all its sums are usable.
    valid_sums : int
        Number of sums that the solver used.
    solve_s : float
        Time of the solver in seconds.
    published_mono_ns : int
        When the image was published.
    number : int
        Number of the image since the reconstructor's start, from 1: images depend on those before. 0 if unknown. A
        reconstructor that takes over counts on.
    doubtful : bytes
        Of the measurement.
    """

    cycle: int
    sync_counter: int
    sampled_mono_ns: int
    published_mono_ns: int
    pixels: bytes
    valid: bytes
    valid_sums: int
    solve_s: float
    number: int = 0
    sampled_error_ns: int = UNKNOWN_ERROR_NS
    doubtful: bytes = b""


class Contact(msgspec.Struct, frozen=True, kw_only=True):
    """A region of the skin that is touched.

    Attributes
    ----------
    identity : int
        Number of the contact, from 1; the same in every image from onset to end. A contact that joined another one has
        its number again when they part; otherwise no number is used twice.
    row, column : float
        Centre of force, in taxels; (0, 0) is the centre of the first taxel. On a skin of positions row 0 and the number
        of the taxel nearest to the centre.
    force_n, peak_n : float
        Sum of the forces of its taxels, and the largest of them, newtons.
    taxels : int
        Number of its taxels.
    top, bottom, left, right : int
        First and last row, first and last column of its taxels. On a skin of positions 0, 0, and the lowest and highest
        number of its taxels, with others between.
    onset_mono_ns : int
        Time of the first image with this contact.
    invalid_taxels : int
        Number of its taxels whose block is not valid: their forces are estimates from their neighbours.
    doubtful_since_mono_ns : int
        Since when it may be an error of the zero, for example a warm patch, and no touch: at least half of its force is
        on doubtful taxels. 0: it is not doubtful.
    position_m : tuple of float
        Centre of force in the frame of the skin, metres: on a grid its middle is (0, 0, 0), x runs along the columns, y
        down the rows, z into the skin; a skin of positions has the frame of its file, and the mean of the positions of
        the taxels by force is a little below a curved skin. (0, 0, 0) in older recordings.
    normal : tuple of float
        Of length 1, out of the skin at the centre: the mean of its taxels' by force.
    """

    identity: int
    row: float
    column: float
    force_n: float
    peak_n: float
    taxels: int
    top: int
    bottom: int
    left: int
    right: int
    onset_mono_ns: int
    invalid_taxels: int = 0
    doubtful_since_mono_ns: int = 0
    position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    normal: tuple[float, float, float] = (0.0, 0.0, -1.0)

    @property
    def doubtful(self) -> bool:
        """Whether it may be an error of the zero."""
        return self.doubtful_since_mono_ns != 0


class EndedContact(msgspec.Struct, frozen=True):
    """A contact that has ended.

    Attributes
    ----------
    identity, onset_mono_ns : int
        Those of its `Contact`.
    end_mono_ns : int
        Time of the last image with this contact; of the joining, if it joined another contact.
    joined : int
        Identity of the contact that it joined; 0 if the touch ended.
    """

    identity: int
    onset_mono_ns: int
    end_mono_ns: int
    joined: int = 0


class Contacts(msgspec.Struct, frozen=True, kw_only=True):
    """The contacts of one image.

    Attributes
    ----------
    cycle, sync_counter, sampled_mono_ns, sampled_error_ns : int
        Of the image.
    contacts : list of Contact
        The strongest first.
    ended : list of EndedContact
        Those that ended since the image before.
    find_s : float
        Time of the search in seconds.
    blind : bool
        No sum was valid: there are no contacts in this message, but that does not mean "no contact".
    number : int
        Of the image.
    """

    cycle: int
    sync_counter: int
    sampled_mono_ns: int
    contacts: list[Contact]
    ended: list[EndedContact]
    find_s: float
    blind: bool = False
    sampled_error_ns: int = UNKNOWN_ERROR_NS
    number: int = 0


#: Label of a contact that differs from all objects of the training.
UNKNOWN_OBJECT: Final = "unknown object"


#: A label from less than this part of the skin's sums is void; it does not mean that there is no contact.
MIN_VALID_RATIO: Final = 0.25


class Label(Told, frozen=True, kw_only=True):
    """The classifier's result for one cycle.

    Attributes
    ----------
    label : str
        The object, `UNKNOWN_OBJECT`, or empty without contact.
    confidence : float
        0 to 1.
    valid_sums : int
        Number of valid sums in this cycle.
    blind : bool
        Too few blocks came in the last cycles: the label is empty, but does not mean "no contact".
    number : int
        Number of the label since the start of its classifier, from 1: labels depend on those before. 0 if unknown.
    """

    cycle: int
    sync_counter: int
    sampled_mono_ns: int
    label: str
    confidence: float
    valid_sums: int
    blind: bool = False
    number: int = 0
    sampled_error_ns: int = UNKNOWN_ERROR_NS

    def is_measured(self, sums: int) -> bool:
        """Tell whether the label, of a skin with `sums` sums, is based on enough sums.

        The empty label of a dead skin does not mean "no contact".
        """
        return not self.blind and self.valid_sums >= MIN_VALID_RATIO * sums


#: Most characters of the label of a mark.
LONGEST_LABEL: Final = 60


class Mark(Told, frozen=True, kw_only=True):
    """What touches the skin from now on, until the next mark: a person or a program says so, and recorders keep it.

    Attributes
    ----------
    label : str
        The name of the object (`check_label`); empty: nothing is said from now on.
    """

    label: str


def is_label(label: str) -> bool:
    """Tell whether an object can have this name; the empty one names none."""
    is_name = isinstance(label, str) and label.isprintable() and label == label.strip() and len(label) <= LONGEST_LABEL
    return is_name and label != UNKNOWN_OBJECT


def check_label(label: str) -> str:
    """Return `label`, if an object can have this name (`is_label`)."""
    if not is_label(label):
        raise InputError(
            f"label {label!r}: expected printable text of up to {LONGEST_LABEL} characters without spaces at its ends,"
            f" other than '{UNKNOWN_OBJECT}', or none"
        )
    return label


class Truth(Told, frozen=True, kw_only=True):
    """True forces of one cycle; only simulated nodes publish them.

    Attributes
    ----------
    step : int
        Position in the taxel source.
    sync_counter, sampled_mono_ns : int
        Of the SYNC as the nodes received it: counter, 0 where SYNC has none, and time stamp. With steps the
        counter is 0, and the time is that of the step: between two steps forces are interpolated.
    true, sensor : bytes
        float32, shape (rows, columns), newtons: before and after noise, clipping and ADC.
    label : str
        The touching object; empty without contact, or if the object is unknown.
    """

    step: int
    sync_counter: int
    sampled_mono_ns: int
    true: bytes
    sensor: bytes
    label: str


class FrameCounts(msgspec.Struct, kw_only=True):
    """Numbers of frames since the gateway's start, by what the collector did with them.

    Attributes
    ----------
    accepted : int
        Frames with sums that were used.
    late, duplicate, malformed : int
        Frames with sums that came after their cycle, came twice, or had a wrong length; they are not used. Stepped:
        late frames came well after their slot, and are used; their blocks are not valid.
    after_gap, unproven : int
        Stepped: frames before which others were lost, and frames of nodes that are not proven; these are not used.
    missing : int
        Frames with sums that did not come in their cycle.
    foreign : int
        All other frames on the buses.
    different : int
        Stepped: words with which a node told that it has other sums than the gateway; their frames are among the
        others.
    """

    accepted: int = 0
    late: int = 0
    duplicate: int = 0
    malformed: int = 0
    missing: int = 0
    foreign: int = 0
    after_gap: int = 0
    unproven: int = 0
    different: int = 0

    @property
    def received(self) -> int:
        """Number of frames with the identifier of a TPDO with sums."""
        return self.accepted + self.late + self.duplicate + self.malformed + self.after_gap + self.unproven


class NmtState(IntEnum):
    """NMT states in the heartbeat (CiA 301, 7.2.8.3.2)."""

    INITIALISING = 0
    STOPPED = 4
    OPERATIONAL = 5
    PRE_OPERATIONAL = 127


#: Value in `BusState.nmt` of a node whose heartbeat is overdue.
SILENT: Final = 255


class Fault(str, Enum):
    """Why the gateway does not use the sums of a node."""

    ABSENT = "absent"  #: Never heard since the start of the gateway.
    AWAY = "away"  #: Absent or silent, as an optional node may be.
    SILENT = "silent"  #: Its heartbeat is overdue.
    OTHER_DEVICE = "other-device"  #: Its identity (1018h) or type (1000h) is another.
    REFUSED = "refused"  #: Its configuration is another.
    UNANSWERED = "unanswered"  #: It sends heartbeats, and answers no SDO request.
    LEFT = "left"  #: It has left OPERATIONAL.
    BOOTED = "booted"  #: It has booted again.
    CHANGED = "changed"  #: Its configuration has become another, or another master writes there.
    UNPROVEN = "unproven"  #: Its configuration was not proven for too long.
    TWICE = "twice"  #: Another board sends sums with its node-ID, or has done so a short while ago.
    STARTING = "starting"  #: Its first proof is under way.
    FROZEN = "frozen"  #: Its values stand still while its frames go on.

    __str__ = str.__str__  # the value, as `enum.StrEnum` of Python 3.11 has it


class NodeFault(Told, frozen=True):
    """Why a node's sums are not used: the kind, and what the gateway has seen, in words."""

    kind: Fault
    words: str = ""

    @property
    def code(self) -> str:
        """The name of the cause in notices, logs and metrics (`health.causes.Cause.code`)."""
        return f"node-{self.kind}"


class NodeEmergency(msgspec.Struct, frozen=True):
    """An emergency of a node: its error code, 0 when no error is left (CiA 301, 7.2.7.1), and when it came."""

    node: int
    code: int
    time_ns: int


#: Codes of causes by the state of the gateway's controller, and of SYNCs that the controller takes in no other.
LINK_CODES: Final = {"lost": "interface-lost", "bus_off": "bus-off", "passive": "error-passive"}
REFUSED_CODE: Final = "sync-refused"


class BusState(Told, frozen=True, kw_only=True):
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
    emergencies : list of NodeEmergency
        The newest ones of each node since the gateway's start, up to `gateway.node_machine.HISTORY`, the oldest first.
    link : str
        Worst state of the gateway's controller since the last status: active, warning, passive, bus_off, or lost.
    trouble : str
        The fault of the gateway's link to the bus and what mends it, in words that follow the bus's name.
    refused : list of int
        Node-IDs that answer but are not used: their configuration differs from the contract.
    overrun : int
        Number of frames that the gateway's receive buffer lost since the start.
    faults : dict of int to NodeFault
        By node-ID, of the nodes whose sums are not used.
    out_s : dict of int to float
        For how long they have not been used any more, seconds; of those that were used before.
    answer_s, heartbeat_s : list of (float, float)
        Least and longest time of each node's answers to SDO requests, and between its heartbeats, in the last 10 s to
        20 s; (0, 0) without any.
    other_sync : str
        Who else has sent SYNC in the last 10 s, in words; empty without.
    """

    name: str
    load_ratio: float
    mean_load_ratio: float = 0.0
    nodes: list[int]
    nmt: bytes
    missing: list[int] = msgspec.field(default_factory=list)
    late: list[int] = msgspec.field(default_factory=list)
    emcy: list[int] = msgspec.field(default_factory=list)
    refused: list[int] = msgspec.field(default_factory=list)
    link: str = "active"
    trouble: str = ""
    overrun: int = 0
    faults: dict[int, NodeFault] = msgspec.field(default_factory=dict)
    out_s: dict[int, float] = msgspec.field(default_factory=dict)
    answer_s: list[tuple[float, float]] = msgspec.field(default_factory=list)
    heartbeat_s: list[tuple[float, float]] = msgspec.field(default_factory=list)
    other_sync: str = ""
    emergencies: list[NodeEmergency] = msgspec.field(default_factory=list)


class GatewayStatus(msgspec.Struct, frozen=True, kw_only=True):
    """The gateway's counters since its start, published five times a second.

    Attributes
    ----------
    cycles, cycles_complete : int
        Number of cycles that have ended, and of cycles in which every block that sends sums was valid.
    sync_rate_hz : float
        Mean rate of the SYNCs since the first; 0 while they are too few for a rate.
    syncs_skipped : int
        Number of SYNCs that were not sent because they were too late.
    calibration : CalibrationStatus or None
        None from a gateway without calibration, as in a replay.
    heartbeat_limit_s, answer_limit_s : float
        A node is silent when no heartbeat came for the first, and has the second for an answer to an SDO request.
    """

    time_ns: int
    cycles: int
    cycles_complete: int
    frames: FrameCounts
    sync_rate_hz: float
    buses: list[BusState]
    syncs_skipped: int = 0
    calibration: CalibrationStatus | None = None
    heartbeat_limit_s: float = 0.0
    answer_limit_s: float = 0.0


class NodesStatus(Told, frozen=True, kw_only=True):
    """Counters of one process of virtual nodes."""

    time_ns: int
    process: str
    frames_sent: int
    frames_dropped: int
    syncs_seen: int


class ServiceStatus(Told, frozen=True, kw_only=True):
    """What a service tells of itself, once a second while it works; its counters begin with its process.

    Attributes
    ----------
    service, instance : str
        Those of its `canskin.peers.Peer`.
    memory_bytes : int
        Resident memory; 0 where the system does not tell.
    processor_s : float
        Processor time of all its threads.
    missed : int
        Messages that did not come: the fabric dropped them, see `canskin.fabric.Missed`.
    overruns : int
        Messages that came, and were replaced by newer ones because the service was too slow for them.
    made : int
        What it is there for: measurements, images, labels, frames of nodes, recorded frames and messages; 0 of others.
        Images and labels of a service that stands by count, too.
    load_ratio : float
        Processor time of its process in the last second, of one core.
    clock_offset_ns, clock_error_ns : int
        How far the monotonic clock of the gateway's machine is ahead, and the bound of the error; `UNKNOWN_ERROR_NS` if
        unknown, or if the service needs no other clock than its own.
    """

    time_ns: int
    service: str
    instance: str
    memory_bytes: int
    processor_s: float
    missed: int = 0
    overruns: int = 0
    made: int = 0
    load_ratio: float = 0.0
    clock_offset_ns: int = 0
    clock_error_ns: int = UNKNOWN_ERROR_NS


class Topic(msgspec.Struct, frozen=True):
    """A type of message and the name of its topic."""

    name: str
    message: type[msgspec.Struct]

    def decoder(self) -> Callable[[bytes], Any]:
        """Return what decodes a message of the topic; it raises one of `canskin.errors.UNDECODABLE`."""
        return _measurement_decoder() if self.message is Measurement else msgspec.msgpack.Decoder(self.message).decode


def _measurement_decoder() -> Callable[[bytes], Measurement]:
    decode_tagged = msgspec.msgpack.Decoder(CycleMeasurement | SteppedMeasurement).decode

    def decode(content: bytes) -> Measurement:
        measurement: Measurement
        try:
            measurement = decode_tagged(content)
        except msgspec.ValidationError:  # of a version, or in a recording, from before there were tags
            fields = msgspec.msgpack.decode(content, type=dict[str, Any])
            measurement = msgspec.convert(fields, SteppedMeasurement if fields.get("known") else CycleMeasurement)
        return measurement

    return decode


MEASUREMENT: Final = Topic("measurement", Measurement)
IMAGE: Final = Topic("image", Image)
CONTACTS: Final = Topic("contacts", Contacts)
LABEL: Final = Topic("label", Label)
TRUTH: Final = Topic("truth", Truth)
MARK: Final = Topic("marks", Mark)
GATEWAY: Final = Topic("gateway", GatewayStatus)
NODES: Final = Topic("nodes", NodesStatus)
SERVICES: Final = Topic("services", ServiceStatus)
