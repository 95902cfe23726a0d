"""The tables of a layout, and what follows from them: skin ▸ bus ▸ node ▸ block ▸ taxel."""

from dataclasses import replace
from functools import cache
from typing import Annotated, Any, Final, Literal

import msgspec
import numpy as np
import numpy.typing as npt

from canskin.errors import InputError, LayoutError
from skin.chains import order_of
from skin.foreign import ForeignMessage
from skin.matrix import MatrixPhi, entries_of
from skin.phi import Sbhe, of_rows, sbhe
from skin.surface import LINK_RATIO, Surface, grid_surface, surface_of_positions
from skin.text_tables import MOST
from skin.walsh import Indices, patches
from skin.ways_of_sending import SENDINGS, Sending, SendingName

#: Lowest and highest bit rate of classic CAN and of the nominal phase, from the table in CiA 301.
BITRATE_MIN: Final = 10_000
BITRATE_MAX: Final = 1_000_000
#: Highest SYNC rate of a layout: far above any skin, to catch typing errors.
RATE_MAX_HZ: Final = 2000.0
#: Highest sampling rate of a layout.
SAMPLING_MAX_HZ: Final = 10_000.0
#: Signs of `taxels.shape`.
TAXEL: Final = "#"
GAP: Final = "."
#: Fewest taxels of a skin.
TAXELS_MIN: Final = 8
#: Most taxels and empty places: those of the largest grid, which has no empty places.
PLACES_MAX: Final = MOST + 1
#: Most rows and columns of a grid.
SIDE_MAX: Final = 256
#: Most places of a block: its taxels are one array of its node's dictionary, which holds 254 entries.
BOARD_MAX: Final = 128
#: Largest bit rate of a CAN FD data phase.
DATA_BITRATE_MAX: Final = 8_000_000
#: Product code of boards whose maker has no vendor number: the characters "SKIN".
PRODUCT_CODE: Final = 0x534B_494E
#: Most nodes of a bus.
NODES_MAX: Final = 127
#: Largest value of an entry of the identity object (1018h).
IDENTITY_MAX: Final = 2**32 - 1
#: Why what boards need is refused.
OTHER_HARDWARE: Final = (
    "the sums of a matrix are made by other hardware, not by boards on a bus: 'skin reconstruct', 'skin classify',"
    " 'skin train' and 'skin layout' take them"
)

#: Least and largest width of a sum in a PDO.
SUM_BITS_MIN: Final = 7
SUM_BITS_MAX: Final = 16
Positive = Annotated[int, msgspec.Meta(gt=0)]
#: Longest name.
NAME_CHARACTERS: Final = 64
Name = Annotated[str, msgspec.Meta(pattern=r"^[a-z][a-z0-9_]*(?!\n)$", max_length=NAME_CHARACTERS)]


class _Table(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A table of the layout file; unknown keys are errors."""


class Taxels(_Table, frozen=True, kw_only=True):
    """The taxels: `rows` x `columns`, `pitch_m` apart, or at `positions`; forces from 0 to `force_max_n` in `adc_bits`.

    A skin with cut-outs, or of several patches, lacks some taxels of its grid: they are gaps of `shape`. A skin that is
    no grid has `positions`, and its arrays have one row.

    `frontend` tells where a sum is made: each taxel has a converter and the node adds numbers (``digital``), or
    currents are added before one converter for each sum (``analogue``, `skin.frontend`). `untouchable` are the taxels
    that nothing can touch, `masked` broken ones that images leave out, both row-major. `has_thermometers` tells that
    the boards measure their temperature (2036h).
    """

    # A line for each row: `#` for a taxel, `.` for a gap; `rows` and `columns` follow from the picture.
    shape: tuple[str, ...] | None = None
    rows: Annotated[int, msgspec.Meta(ge=1, le=SIDE_MAX)] = 64
    columns: Annotated[int, msgspec.Meta(ge=1, le=PLACES_MAX)] = 64
    # x, y and z of each taxel in metres, or these and its normal; in a file, the path of a CSV.
    positions: Annotated[tuple[tuple[float, ...], ...], msgspec.Meta(max_length=PLACES_MAX)] | None = None
    # Taxels at positions are neighbours up to this times their median spacing.
    link_ratio: Annotated[float, msgspec.Meta(ge=1, le=4)] = LINK_RATIO
    pitch_m: Annotated[float, msgspec.Meta(ge=1e-6, le=0.5)] = 0.004
    force_max_n: Annotated[float, msgspec.Meta(ge=1e-6, le=1e6)] = 0.02
    adc_bits: Annotated[int, msgspec.Meta(ge=1, le=16)] = 10
    frontend: Literal["digital", "analogue"] = "digital"
    untouchable: tuple[int, ...] | None = None
    masked: tuple[int, ...] | None = None
    has_thermometers: bool = False

    @property
    def is_analogue(self) -> bool:
        """Whether sums are made before the converters."""
        return self.frontend == "analogue"

    @property
    def count(self) -> int:
        """Number of taxels n of the grid, gaps included."""
        return self.rows * self.columns

    @property
    def is_masked(self) -> npt.NDArray[np.bool_]:
        """Whether each taxel is left out of images, shape (n,)."""
        return np.isin(np.arange(self.count), self.masked or ())

    @property
    def gaps(self) -> Indices:
        """Taxels that the grid lacks, row-major."""
        signs = np.frombuffer("".join(self.shape or ()).encode(), np.uint8)
        return np.flatnonzero(signs == ord(GAP))

    @property
    def there(self) -> int:
        """Number of taxels that there are: n without gaps."""
        return self.count - sum(line.count(GAP) for line in self.shape or ())

    def without_gaps(self, forces: npt.NDArray[np.floating]) -> npt.NDArray[np.floating]:
        """Return the forces of the taxels that there are, shape (there,), of those of all, shape (rows, columns)."""
        return np.delete(forces, self.gaps)

    @property
    def surface(self) -> Surface:
        """Where the taxels lie, and which are neighbours."""
        return _surface(self)

    @property
    def words(self) -> str:
        """Number of taxels as text: rows x columns of a full grid."""
        is_full = self.positions is None and self.there == self.count
        return f"{self.rows} x {self.columns} taxels" if is_full else f"{self.there} taxels"

    @property
    def count_max(self) -> int:
        """Largest ADC count."""
        return (1 << self.adc_bits) - 1

    @property
    def newton_per_count(self) -> float:
        """Force of one ADC count."""
        return self.force_max_n / self.count_max


@cache
def _surface(taxels: Taxels) -> Surface:
    if taxels.positions is not None:
        return surface_of_positions(taxels.positions, taxels.link_ratio)
    return grid_surface(taxels.rows, taxels.columns, taxels.pitch_m, taxels.gaps)


class PhiParameters(_Table, frozen=True, kw_only=True):
    """The parameters from which Φ is drawn, or its `matrix`."""

    ensemble: Literal["sbhe", "matrix"] = "sbhe"
    # Rows of signs, `+`, `-` and `0`, of each frame; in a file, the path of a CSV or .npz, or the rows of one Φ.
    matrix: tuple[tuple[Annotated[str, msgspec.Meta(pattern="^[-+0]+$")], ...], ...] | None = None
    block_size: Annotated[int, msgspec.Meta(ge=2, le=BOARD_MAX)] = 32
    sums: Positive = 1024
    # Block and Hadamard row of each sum; without the key they are drawn.
    rows: Annotated[tuple[tuple[int, int], ...], msgspec.Meta(min_length=1)] | None = None
    selection: Literal["balanced", "uniform"] = "balanced"
    seed: Annotated[int, msgspec.Meta(ge=0, le=2**32 - 1)] = 1
    # Blocks of taxels from all over the skin, of neighbours (a patch of each board), or those of `chains`.
    wiring: Literal["scattered", "board", "file"] = "scattered"
    # Boards that exist: the taxels of each block by place, -1 for a place without one; in a file, the path of a CSV.
    chains: Annotated[tuple[tuple[int, ...], ...], msgspec.Meta(min_length=1)] | None = None


class Sync(_Table, frozen=True, kw_only=True):
    """The SYNC producer: `rate_hz` cycles a second (CiA 301, 1005h and 1006h).

    A node sends all its sums in every cycle, or, with two `turns`, half of its frames in odd cycles and half in even
    ones. Boards that send steps have slots in place of cycles (`Steps`), and no turns. With `time_s` the gateway
    produces TIME, too (CiA 301, 7.2.6): after a SYNC, every `time_s` seconds.
    """

    # The lower limit keeps the period of 1006h, microseconds in 32 bits, far from overflow.
    rate_hz: Annotated[float, msgspec.Meta(ge=0.1, le=RATE_MAX_HZ)] = 100.0
    turns: Literal[1, 2] = 1
    time_s: Annotated[float, msgspec.Meta(ge=0.1, le=86_400.0)] | None = None

    @property
    def period_s(self) -> float:
        """Communication cycle period (1006h) in seconds."""
        return 1 / self.rate_hz

    @property
    def round_s(self) -> float:
        """Time in which every sum comes once, seconds."""
        return self.turns * self.period_s


class Steps(_Table, frozen=True, kw_only=True):
    """When stepped boards send: a board has one slot for each of its words in `slot_s`, a part of the SYNC period.

    Attributes
    ----------
    slot_s : float
    quiet : float
        With 0 a board sends in every slot. Above, a slot stays empty unless the frame takes more than this times its
        noise (`dbc.steps.NOISE_RATIO`) from the squared difference.
    at_sync : bool
        All boards send at SYNC, the start of their slot. Otherwise each has its own place in the slot.
    """

    slot_s: Annotated[float, msgspec.Meta(ge=1e-3, le=10.0)] = 0.004
    quiet: Annotated[float, msgspec.Meta(ge=0, le=1000)] = 0.1
    at_sync: bool = False


class Sampling(_Table, frozen=True, kw_only=True):
    """How often a node samples its taxels: `rate_hz` times a second, or, without it, once per SYNC."""

    rate_hz: Annotated[float, msgspec.Meta(ge=0.1, le=SAMPLING_MAX_HZ)] | None = None


class Encoding(_Table, frozen=True, kw_only=True):
    """Encoding of a sum in a PDO: `sum_bits`, in two's complement or, with fewer stuff bits, `offset_binary`."""

    sum_bits: Annotated[int, msgspec.Meta(ge=SUM_BITS_MIN, le=SUM_BITS_MAX)] = 14
    offset_binary: bool = False


class Device(_Table, frozen=True, kw_only=True):
    """The boards: identity (CiA 301, 1018h), the numbers of their maker and the serial number of the board of block 0.

    The serial number of a board is `first_serial` + its first block. Vendor-ID 0 means that CiA has assigned none.
    `jitter_s` is the longest time from SYNC until a board has queued its TPDOs: stock stacks run in a timer of 1 ms.
    """

    vendor_id: Annotated[int, msgspec.Meta(ge=0, le=IDENTITY_MAX)] = 0
    product_code: Annotated[int, msgspec.Meta(ge=0, le=IDENTITY_MAX)] = PRODUCT_CODE
    first_serial: Annotated[int, msgspec.Meta(ge=1, le=IDENTITY_MAX)] = 1
    jitter_s: Annotated[float, msgspec.Meta(ge=0, le=1)] = 1e-3


NodeId = Annotated[int, msgspec.Meta(ge=1, le=NODES_MAX)]


class Bus(_Table, frozen=True, kw_only=True):
    """One CAN bus: `nodes` boards, nominal `bitrate` in bit/s, and the messages of other devices (`foreign`).

    The boards have consecutive node-IDs from `first_node_id` on, default 1, or those of `node_ids`; those of `optional`
    may be absent (CiA 302-2). With `fd` the sums are sent in CAN FD frames of up to 64 bytes, with the data phase at
    `data_bitrate` if given.
    """

    name: Name
    nodes: Annotated[int, msgspec.Meta(ge=1, le=NODES_MAX)]
    first_node_id: NodeId | None = None
    node_ids: Annotated[tuple[NodeId, ...], msgspec.Meta(min_length=1)] | None = None
    optional: Annotated[tuple[NodeId, ...], msgspec.Meta(min_length=1)] | None = None
    blocks_per_node: Literal[1, 2, 4, 8] = 1
    bitrate: Annotated[int, msgspec.Meta(ge=BITRATE_MIN, le=BITRATE_MAX)] = BITRATE_MAX
    fd: bool = False
    data_bitrate: Annotated[int, msgspec.Meta(ge=BITRATE_MIN, le=DATA_BITRATE_MAX)] | None = None
    foreign: tuple[ForeignMessage, ...] = ()
    # In a file the path of a .dbc with more of them, which `parse_layout` puts in place of the path.
    foreign_dbc: str | None = None

    @property
    def ids(self) -> tuple[int, ...]:
        """Node-IDs of the boards, ascending."""
        first = self.first_node_id or 1
        return self.node_ids or tuple(range(first, first + self.nodes))


class Region(_Table, frozen=True, kw_only=True):
    """A part of the skin with a name; `skin.regions` tells which taxels are of it.

    `box` is the first row, first column, last row and last column of a region, the last ones in it; taxels at positions
    are one row. `part` is the number of a connected part of the skin. A region without both is the whole skin. Above
    `threshold_n` the total force of the region is told.
    """

    name: Name
    box: tuple[Annotated[int, msgspec.Meta(ge=0)], ...] | None = None
    part: Annotated[int, msgspec.Meta(ge=0)] | None = None
    threshold_n: Annotated[float, msgspec.Meta(gt=0)] | None = None


class Layout(_Table, frozen=True, kw_only=True):
    """The layout of a skin: all settings that its services and nodes share.

    Examples
    --------
    >>> layout = load_layout()
    >>> layout.taxels.count, len(layout.bus), layout.phi().shape
    (4096, 4, (1024, 4096))
    """

    name: Name = "skin"
    configure: Literal["write", "refuse"] = "write"
    # Sums at every SYNC, or whenever a frame is worth its bits.
    sending: SendingName = "synchronous"
    taxels: Taxels = msgspec.field(default_factory=Taxels)
    measurement: PhiParameters = msgspec.field(default_factory=PhiParameters)
    sync: Sync = msgspec.field(default_factory=Sync)
    sampling: Sampling = msgspec.field(default_factory=Sampling)
    steps: Steps = msgspec.field(default_factory=Steps)
    encoding: Encoding = msgspec.field(default_factory=Encoding)
    device: Device = msgspec.field(default_factory=Device)
    # Without them, the connected parts of the skin.
    region: list[Region] | None = None
    # None if other hardware makes the sums.
    bus: list[Bus]

    @property
    def sends(self) -> Sending:
        """What the way of sending means for the skin."""
        return SENDINGS[self.sending]

    @property
    def blocks(self) -> int:
        """Number of blocks (measurement groups): those of `chains`, or as few as hold the taxels; of a matrix sums."""
        return blocks_of(self.taxels, self.measurement)

    @property
    def places(self) -> int:
        """Number of places of all blocks: taxels and empty places."""
        return self.blocks * self.measurement.block_size

    @property
    def slots(self) -> int:
        """Number of slots of a stepped board from SYNC to SYNC."""
        return round(self.sync.period_s / self.steps.slot_s)

    @property
    def samples_per_sync(self) -> int:
        """Samples of each taxel in one cycle, the last one at the SYNC; more than one are averaged."""
        return round((self.sampling.rate_hz or self.sync.rate_hz) / self.sync.rate_hz)

    @property
    def is_of_one_instant(self) -> bool:
        """Whether all sums of a measurement were sampled at one SYNC."""
        return self.sends.in_cycles and self.sync.turns == 1

    def operator(self) -> Sbhe | MatrixPhi:
        """Return the skin's measurement operator, for what takes any; the same layout always gives the same Φ."""
        matrix = self.measurement.matrix
        if matrix is None:
            return self.phi()
        is_wired = np.ones(self.taxels.count, np.bool_)
        is_wired[self.taxels.gaps] = False
        return MatrixPhi(entries_of(matrix), is_wired)

    def phi(self) -> Sbhe:
        """Draw the measurement operator of a skin whose boards make the sums; LayoutError if other hardware does."""
        taxels, drawn = self.taxels, self.measurement
        require_boards(self)
        count = drawn.sums if drawn.rows is None else self.blocks
        phi = sbhe(
            taxels.count,
            count,
            block_size=drawn.block_size,
            blocks=self.blocks,
            gaps=taxels.gaps,
            selection=drawn.selection,
            seed=drawn.seed,
        )
        if drawn.chains is not None:
            phi = replace(phi, order=order_of(drawn.chains, taxels.count, drawn.block_size))
        elif drawn.wiring == "board":
            phi = replace(phi, order=np.concatenate(self.patches()).ravel())
        return phi if drawn.rows is None else of_rows(phi, drawn.rows)

    def patches(self) -> list[Indices]:
        """Return the taxels of each block of neighbours, by bus; see `skin.walsh.patches`."""
        if self.measurement.chains is not None:
            return np.split(self.phi().taxels_of_blocks, np.cumsum(self._held)[:-1])
        return patches(self.taxels.surface, self.measurement.block_size, self._held, self.taxels.gaps)

    @property
    def _held(self) -> list[int]:
        return [bus.nodes * bus.blocks_per_node for bus in self.bus]

    def first_block(self, bus: int) -> int:
        """Return the first block of the first node on bus number `bus`; the blocks of the other nodes follow."""
        return sum(self._held[:bus])


def changed(layout: Layout, **tables: Any) -> Layout:
    """Return the layout, not checked, with other tables, or with other values of the keys in a dict.

    Examples
    --------
    >>> changed(layout, sync={"rate_hz": 50.0}, sampling=Sampling())
    """
    given = {
        name: msgspec.structs.replace(getattr(layout, name), **keys) if isinstance(keys, dict) else keys
        for name, keys in tables.items()
    }
    return msgspec.structs.replace(layout, **given)


def require_sending(layout: Layout, sending: SendingName, what: str, why: str) -> None:
    """Check that a layout has the way of sending that `what` is for; `why` is the reason, or what to do."""
    if layout.sending != sending:
        raise InputError(f"{what} for {sending} sending: {why}")


def require_boards(layout: Layout) -> None:
    """Check that boards make the sums of a layout."""
    if layout.measurement.matrix is not None:
        raise LayoutError(f"{layout.name}: {OTHER_HARDWARE} - at `$.measurement.ensemble`")


def blocks_of(taxels: Taxels, measurement: PhiParameters) -> int:
    """Return the number of blocks; of a matrix that of its sums."""
    if measurement.chains is not None:
        return len(measurement.chains)
    if measurement.matrix is not None:
        return measurement.sums
    return -(-taxels.there // measurement.block_size)
