"""State of a skin at one instant: the answer of ``/api/state`` and the header of every frame of the page."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import msgspec
import numpy as np
import numpy.typing as npt

from canskin.messages import SILENT, BusState, Contacts, Fault, GatewayStatus, Label, NmtState, NodesStatus

Pixels = npt.NDArray[np.float32]
#: States of the gateway's controller in which it neither sends nor receives.
DEAD_LINKS: Final = ("lost", "bus_off")


class Notice(msgspec.Struct, frozen=True, kw_only=True):
    """One thing that is wrong, for the user; `health.causes.Cause.notice` makes it.

    Attributes
    ----------
    level : str
        "info" (start is not finished), "warning" (degraded) or "error" (stopped).
    code : str
        Of the cause, see `health.causes.Cause`.
    subject : str
        What it is about, for example ``left node 2``; with `code` the same for as long as the condition lasts.
    text : str
        What is seen, with its evidence.
    mend : str
        What to do.
    since_time_s : float or None
        Wall-clock time when the condition began.
    """

    level: str
    code: str
    text: str
    mend: str
    subject: str = ""
    since_time_s: float | None = None


class Service(msgspec.Struct, frozen=True, kw_only=True):
    """State of a service, from its liveliness token and its messages.

    Attributes
    ----------
    alive : bool
        The process runs: its token exists.
    silent : bool
        The process runs and has input, but sends nothing.
    since_time_s : float
        Wall-clock time when the token came or went.
    version, fingerprint, scheduling : str
        From the token; see `canskin.peers.Peer`.
    difference : str
        Why the service cannot work with this page's skin; empty if it can.
    memory_bytes, processor_ratio, made_per_s : int or float, or None
        Of the last second, as `canskin.messages.ServiceStatus` tells: resident memory, processor time / time, and what
        the service made. Those of all services of this name together; None if none tells.
    processor_s, missed, overruns : float or int, or None
        As `canskin.messages.ServiceStatus` tells: the sums of all processes of this name, also of those that have
        ended; None if none has told.
    loses_since_time_s : float or None
        Wall-clock time since when more and more are lost.
    clock_offset_s, clock_error_s : float or None
        Of a service that uses the clock of the gateway's machine: how far that clock is ahead of its own, and the bound
        of the error. Of several with one name, those of the largest error.
    """

    alive: bool
    since_time_s: float
    silent: bool = False
    version: str = ""
    fingerprint: str = ""
    scheduling: str = ""
    difference: str = ""
    memory_bytes: int | None = None
    processor_ratio: float | None = None
    made_per_s: float | None = None
    processor_s: float | None = None
    missed: int | None = None
    overruns: int | None = None
    loses_since_time_s: float | None = None
    clock_offset_s: float | None = None
    clock_error_s: float | None = None

    @property
    def lost(self) -> int:
        """Messages that did not come, or came too fast."""
        return (self.missed or 0) + (self.overruns or 0)


class ImageState(msgspec.Struct, frozen=True, kw_only=True):
    """The newest image; ``stale`` when it is too old to be the present touch.

    Attributes
    ----------
    invalid_blocks : list of int
        Blocks without valid sums in this cycle; the solver has estimated the forces of their taxels.
    sampled_error_ns : int
        Bound of the error of the sampling instant, see `canskin.messages.Measurement`.
    """

    cycle: int
    sampled_error_ns: int
    age_s: float
    stale: bool
    invalid_blocks: list[int]
    valid_sums: int
    solve_s: float


class TruthState(msgspec.Struct, frozen=True):
    """The true and the sensor image of the cycle of the image shown, and the age of the image."""

    step: int
    label: str
    age_s: float
    stale: bool


class PatchState(msgspec.Struct, frozen=True, kw_only=True):
    """The force on a region of the skin (`skin.regions`) in the newest image.

    Attributes
    ----------
    force_n : float or None
        Total force, newtons; None if no taxel of the region was measured.
    is_over, over_since_time_s, peak_n : bool, float or None, float or None
        In an image of the last second the force was above `threshold_n`; wall-clock time since when, and the largest
        force since then.
    row, column, position_m
        Centre of pressure, see `canskin.messages.Contact`; None without force.
    is_doubtful : bool
        More than `health.patches.DOUBT_RATIO` of its taxels are of blocks that were not measured, or as much of its
        force is on taxels whose zero is in doubt.
    """

    name: str
    force_n: float | None
    threshold_n: float | None = None
    is_over: bool = False
    over_since_time_s: float | None = None
    peak_n: float | None = None
    row: float | None = None
    column: float | None = None
    position_m: tuple[float, float, float] | None = None
    is_doubtful: bool = False


class ContactsState(Contacts, frozen=True, kw_only=True):
    """The contacts of the newest image, and their age."""

    age_s: float
    stale: bool


class LabelState(Label, frozen=True, kw_only=True):
    """The classifier's newest label, and its age; an empty ``label`` means no contact if ``measured`` is true.

    Attributes
    ----------
    measured : bool
        False when too few sums were valid for a label; see `canskin.messages.Label.is_measured`.
    """

    measured: bool
    age_s: float
    stale: bool


class Figures(msgspec.Struct, frozen=True, kw_only=True):
    """Figures of the last seconds; None without a measurement.

    Attributes
    ----------
    images_hz : float
        Rate of the images with at least one valid sum, by the clock of their sampling instants: images that come in a
        burst after a stall are no more than the cycles of the skin.
    latency_p50_s, latency_p99_s : float or None
        Time from SYNC to the publication of such an image, median and 99th percentile.
    psnr_image_db, psnr_sensor_db : float or None
        Mean PSNR over the cycles with contact of the last second; the reference is the truth.
    sensor_adds_noise : bool or None
        False when the sensor only rounds to ADC counts, as with a recording.
    valid_blocks, valid_blocks_low : int or None
        Number of valid blocks in the newest image, and the smallest such number in the last second.
    """

    images_hz: float
    latency_p50_s: float | None
    latency_p99_s: float | None
    psnr_image_db: float | None
    psnr_sensor_db: float | None
    sensor_adds_noise: bool | None
    valid_blocks: int | None
    valid_blocks_low: int | None
    blocks: int


class NodeTrouble(msgspec.Struct, frozen=True):
    """Why a node is not whole, and the wall-clock time since when.

    Attributes
    ----------
    why : str
        Evidence, in words.
    code, word : str
        Of the cause, and words that all nodes with this trouble share.
    """

    node: int
    since_time_s: float
    why: str
    code: str
    word: str


class BusView(BusState, frozen=True, kw_only=True, eq=False):
    """One bus: the gateway's counters, and conclusions from them; made once for each message of the gateway.

    Attributes
    ----------
    nmt : list of int
        State of each node.
    dead : bool
        The gateway can neither send nor receive on this bus.
    synced : bool
        SYNC reaches at least one node: without nodes no frame of the gateway is acknowledged.
    nodes_why : list of NodeTrouble
        Of each node that is not whole.
    level : str
        As of a `Notice`, "info" for nothing wrong. A bus without any operational node is an error once SYNC runs.
    """

    nmt: list[int]  # type: ignore[assignment]  # numbers in JSON, where bytes would be Base64
    dead: bool
    synced: bool
    nodes_why: list[NodeTrouble]
    level: str


class GatewayState(GatewayStatus, frozen=True, kw_only=True):
    """The gateway's newest counters, and their age.

    Attributes
    ----------
    zero : str
        What the zero of the blocks rests on, and its age, in words; empty if unknown.
    late, late_since_time_s : str, float or None
        What the gateway's host has left out lately, in words, and the wall-clock time since when.
    """

    age_s: float
    stale: bool
    zero: str
    late: str = ""
    late_since_time_s: float | None = None
    buses: list[BusView]  # type: ignore[assignment]  # with more fields than `BusState`


class NodesState(NodesStatus, frozen=True, kw_only=True):
    """The newest counters of one process of virtual nodes, and their age."""

    age_s: float
    stale: bool


class RecorderState(msgspec.Struct, frozen=True, kw_only=True):
    """The recording that the page's server is making."""

    path: str
    since_time_s: float


class PlaybackState(msgspec.Struct, frozen=True, kw_only=True):
    """The recording that is shown, and the position in it, seconds from its first message."""

    path: str
    position_s: float
    duration_s: float
    is_paused: bool
    speed: float


class Moment(msgspec.Struct, frozen=True):
    """A skin at one instant, for curves: None for what was not measured then.

    Attributes
    ----------
    force_n : float or None
        On the whole skin.
    latency_s : float or None
        Of the newest image, from SYNC to its publication.
    load_ratio : float or None
        The largest of the buses.
    missing : int or None
        Frames with sums that did not come, since the start of the gateway.
    label : str or None
        Empty without contact.
    mark : str or None
        What touches the skin, as the newest mark says; empty where that says nothing.
    contacts : list of (int, float), or None
        Identity and force in newtons of each contact.
    """

    force_n: float | None
    latency_s: float | None
    load_ratio: float | None
    missing: int | None
    label: str | None
    mark: str | None
    contacts: list[tuple[int, float]] | None


class Snapshot(msgspec.Struct, frozen=True, kw_only=True):
    """Content of the page without pixels; ``cut_off`` when the viewer has lost the hub.

    Attributes
    ----------
    moment : Moment
        What the history has of this instant.
    patches : list of PatchState
        The whole skin, then its regions; empty before the first image.
    other_skins : list of str
        Names of other skins whose services are on the hub.
    ignored : int
        Messages that did not fit the skin; 0 when none has come lately.
    """

    time_s: float
    skin: str
    moment: Moment
    image: ImageState | None
    contacts: ContactsState | None
    truth: TruthState | None
    patches: list[PatchState]
    label: LabelState | None
    figures: Figures
    gateway: GatewayState | None
    nodes: list[NodesState]
    services: dict[str, Service]
    other_skins: list[str]
    cut_off: bool
    ignored: int
    notices: list[Notice]
    recorder: RecorderState | None = None
    playback: PlaybackState | None = None


@dataclass(frozen=True)
class Pictures:
    """The pixels of a snapshot, newtons, shape (rows, columns); None for a picture that is not shown."""

    image: Pixels | None
    true: Pixels | None
    sensor: Pixels | None


def bus_views(status: GatewayStatus, troubles: Mapping[str, list[NodeTrouble]]) -> list[BusView]:
    """Return the buses as the page shows them; `troubles` of the nodes by the name of their bus."""
    return [_bus_view(bus, troubles.get(bus.name, []), runs=status.cycles > 0) for bus in status.buses]


def _bus_view(bus: BusState, troubles: list[NodeTrouble], *, runs: bool) -> BusView:
    is_dead = bus.link in DEAD_LINKS
    away = {node for node, fault in bus.faults.items() if fault.kind is Fault.AWAY}
    wanted = {nmt for node, nmt in zip(bus.nodes, bus.nmt, strict=True) if node not in away}
    is_gone = is_dead or (runs and bool(wanted) and NmtState.OPERATIONAL not in wanted)
    has_trouble = bus.trouble or wanted - {NmtState.OPERATIONAL}
    more = {
        "nmt": list(bus.nmt),
        "dead": is_dead,
        "nodes_why": troubles,
        "level": "error" if is_gone else "warning" if has_trouble else "info",
        "synced": not is_dead and not (bus.link == "passive" and set(bus.nmt) == {SILENT}),
    }
    return BusView(**{**msgspec.structs.asdict(bus), **more})
