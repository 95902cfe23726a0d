"""What the page shows at one instant, as plain data: the answer of ``/api/state`` and the header of every frame."""

from dataclasses import dataclass

import msgspec
import numpy as np
import numpy.typing as npt

from skin.messages import BusState, GatewayStatus, NodesStatus

Pixels = npt.NDArray[np.float32]


class Notice(msgspec.Struct, frozen=True, kw_only=True):
    """One line a person should read.

    Attributes
    ----------
    level : str
        "info" (something is still to come), "warning" (degraded) or "error" (stopped).
    since_time_s : float or None
        Wall-clock time when it began.
    """

    level: str
    text: str
    since_time_s: float | None = None


class Service(msgspec.Struct, frozen=True, kw_only=True):
    """A service as its liveliness token and its messages tell.

    Attributes
    ----------
    alive : bool
        Its process is there.
    silent : bool
        It is there and sends nothing, though it should.
    since_time_s : float
        When it came or went.
    version, fingerprint : str
        What it says of itself; see `skin.peers.Peer`.
    difference : str
        Why it cannot work with this page's skin; empty when it can.
    """

    alive: bool
    since_time_s: float
    silent: bool = False
    version: str = ""
    fingerprint: str = ""
    difference: str = ""


class ImageState(msgspec.Struct, frozen=True, kw_only=True):
    """The newest image; ``stale`` when it must not be taken for what the skin feels now.

    Attributes
    ----------
    invalid_blocks : list of int
        Blocks that were not measured in this cycle; the pixels of their taxels are guesses.
    """

    cycle: int
    age_s: float
    stale: bool
    invalid_blocks: list[int]
    valid_sums: int
    solve_s: float


class TruthState(msgspec.Struct, frozen=True, kw_only=True):
    """The true and the sensor image; ``of_image`` when they belong to the very cycle of the image shown."""

    step: int
    label: str
    age_s: float
    stale: bool
    of_image: bool


class LabelState(msgspec.Struct, frozen=True, kw_only=True):
    """What the classifier said last; an empty ``label`` means no contact, but only where ``measured``.

    Attributes
    ----------
    measured : bool
        False when too little of the skin was measured to say anything; see `skin.labels.is_measured`.
    """

    label: str
    confidence: float
    measured: bool
    age_s: float
    stale: bool


class Figures(msgspec.Struct, frozen=True, kw_only=True):
    """Figures of the last seconds; None where nothing was measured.

    Attributes
    ----------
    images_hz : float
        Images that show something measured.
    latency_p50_s, latency_p99_s : float or None
        SYNC to such an image.
    psnr_image_db, psnr_sensor_db : float or None
        Mean over the contact cycles of the last second, against the truth.
    sensor_adds_noise : bool or None
        False when the sensor only rounds to its ADC's steps, as with a recording.
    valid_blocks, valid_blocks_low : int or None
        Blocks measured in the newest image, and the fewest in the last second.
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


class BusView(BusState, frozen=True, kw_only=True):
    """One bus: what the gateway says of it, and what follows.

    Attributes
    ----------
    nmt : list of int
        State of each node.
    dead : bool
        Nothing passes between the gateway and this bus.
    synced : bool
        SYNC reaches a node: without any, no frame of the gateway is acknowledged.
    """

    nmt: list[int]  # type: ignore[assignment]  # numbers in JSON, where bytes would be Base64
    dead: bool
    synced: bool


class GatewayState(GatewayStatus, frozen=True, kw_only=True):
    """The gateway's newest counters, and how old they are."""

    age_s: float
    stale: bool
    buses: list[BusView]  # type: ignore[assignment]  # which are the gateway's, and more


class NodesState(NodesStatus, frozen=True, kw_only=True):
    """The newest counters of one process of virtual nodes, and how old they are."""

    age_s: float
    stale: bool


class Snapshot(msgspec.Struct, frozen=True, kw_only=True):
    """Everything the page shows, but the pixels; ``cut_off`` when the viewer itself hears nobody.

    Attributes
    ----------
    other_skins : list of str
        Names of other skins whose services are on the hub.
    """

    time_s: float
    skin: str
    image: ImageState | None
    truth: TruthState | None
    label: LabelState | None
    figures: Figures
    gateway: GatewayState | None
    nodes: list[NodesState]
    services: dict[str, Service]
    other_skins: list[str]
    cut_off: bool
    ignored: int
    notices: list[Notice]


@dataclass(frozen=True)
class Pictures:
    """The pixels that go with a snapshot, newtons, shape (rows, columns); None where there is nothing to show."""

    image: Pixels | None
    true: Pixels | None
    sensor: Pixels | None
