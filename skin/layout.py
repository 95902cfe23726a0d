"""The layout of one skin: skin ▸ bus ▸ node ▸ block ▸ taxel, read from one TOML file."""

import contextlib
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import msgspec
import numpy as np
import numpy.typing as npt
import tomli_w

from canskin.errors import UNDECODABLE, InputError, LayoutError, reasoned
from recording import is_recording
from skin.chains import MOST, check_chains, order_of, read_chains, read_positions
from skin.choice import BUSES_MAX, averaged_hz, carried_sums, carries_enough
from skin.foreign import ForeignMessage, check_foreign, with_foreign_dbc
from skin.matrix import KEY, MatrixPhi, entries_of, read_matrix
from skin.measurement import Sbhe, of_rows, sbhe
from skin.sending import BUS_SUMS, IN_CYCLES, SENDINGS, STEPPED_SIZES, Sending, SendingName
from skin.surface import LINK_RATIO, Surface, grid_surface, surface_of_positions
from skin.sync_counter import SYNC_OVERFLOW
from skin.toml_errors import in_words
from skin.walsh import Indices, patches
from skin.wiring import check_patch, within_patches

#: Names of the layouts that come with the project.
SHIPPED: Final = tuple(
    sorted(Path(each.name).stem for each in files("skin.layouts").iterdir() if each.name.endswith(".toml"))
)
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
#: Slots fill the SYNC period up to this ratio: a part of a period may have no decimal fraction.
_SLOT_ERROR: Final = 1e-6
#: Begins the errors of layouts whose boards send steps.
_OF_STEPS: Final = '`sending = "steps"` expects'
#: Fewest taxels of a skin.
TAXELS_MIN: Final = 8
#: Most taxels and empty places: those of the largest grid, which has no empty places.
PLACES_MAX: Final = MOST + 1
#: Most rows and columns of a grid.
SIDE_MAX: Final = 256
#: Fewest places of a block of a board that exists, if `block_size` is not given; else the power of two that holds it.
BOARD_MIN: Final = 8
#: Most places of a block: its taxels are one array of its node's dictionary, which holds 254 entries.
BOARD_MAX: Final = 128
#: Largest bit rate of a CAN FD data phase.
DATA_BITRATE_MAX: Final = 8_000_000

#: Product code of boards whose maker has no vendor number: the characters "SKIN".
PRODUCT_CODE: Final = 0x534B_494E
#: Default: the smallest number of buses with at most this number of nodes, each of one block, and identifiers for all.
NODES_PER_BUS: Final = 32
#: Most nodes of a bus.
NODES_MAX: Final = 127
#: Fewest bits of a converter of sums: its two end codes count as saturated.
ANALOGUE_BITS: Final = 4
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
Name = Annotated[str, msgspec.Meta(pattern=r"^[a-z][a-z0-9_]*$", max_length=NAME_CHARACTERS)]


class _Table(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A table of the layout file; unknown keys are errors."""


class Taxels(_Table, frozen=True, kw_only=True):
    """The taxels: `rows` x `columns`, `pitch_m` apart, or at `positions`; forces from 0 to `force_max_n` in `adc_bits`.

    A skin with cut-outs, or of several patches, lacks some taxels of its grid: they are gaps of `shape`. A skin that is
    no grid has `positions`, and its arrays have one row.

    `frontend` tells where a sum is made: each taxel has a converter and the node adds numbers (``digital``), or
    currents are added before one converter for each sum (``analogue``, `skin.frontend`). `untouchable` are the taxels
    that nothing can touch, row-major. `has_thermometers` tells that the boards measure their temperature (2036h).
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
    # Scattered blocks: side of the region that holds a block, taxels; without the key the whole skin.
    patch: Literal[8, 16, 32, 64] | None = None


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

    The boards have consecutive node-IDs from `first_node_id` on, default 1, or those of `node_ids`. With `fd` the sums
    are sent in CAN FD frames of up to 64 bytes, with the data phase at `data_bitrate` if given.
    """

    name: Name
    nodes: Annotated[int, msgspec.Meta(ge=1, le=NODES_MAX)]
    first_node_id: NodeId | None = None
    node_ids: Annotated[tuple[NodeId, ...], msgspec.Meta(min_length=1)] | None = None
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
        return _blocks(self.taxels, self.measurement)

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
        elif drawn.patch is not None:
            phi = within_patches(phi, taxels.rows, taxels.columns, drawn.patch, self._held)
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


def load_layout(path: Path | None = None) -> Layout:
    """Read a layout: a file, that of a recording, or one of `SHIPPED` by its bare name; without a path, the default."""
    name = "default" if path is None else str(path)
    return parse_layout(*_read(path, name), is_whole=is_recording(path))


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


def _read(path: Path | None, name: str) -> tuple[bytes, str, Path]:
    """Return content and origin of a layout, and the folder of the files that it names."""
    if path is None or (name in SHIPPED and not path.is_file()):
        folder = files("skin.layouts")
        return folder.joinpath(f"{name}.toml").read_bytes(), f"{name}.toml", Path(str(folder))
    if is_recording(path):
        return _read_attached(path), name, path.parent
    if not path.suffix and not path.exists():
        raise LayoutError(f"{path}: no such file, and no layout of canskin: expected {', '.join(SHIPPED)}, or a file")
    with reasoned(LayoutError, f"{path}: cannot read the layout"):
        return path.read_bytes(), name, path.parent


def _read_attached(path: Path) -> bytes:
    """Return the layout in a recording."""
    from recording.mcap_file import LAYOUT_FILE, read_about

    try:
        content = read_about(path).files.get(LAYOUT_FILE)
    except InputError as error:
        raise LayoutError(str(error)) from error
    if content is None:
        raise LayoutError(f"{path}: this recording has no layout, or a damaged one: give the layout's own file")
    return content


def layout_tables(path: Path | None) -> tuple[dict[str, Any], str]:
    """Return what the file of a layout says, without any default, and the file's name; a path as `load_layout` takes.

    Only for a layout that `load_layout` has read.
    """
    content, origin, _ = _read(path, "default" if path is None else str(path))
    return msgspec.toml.decode(content), origin


def parse_layout(content: bytes, origin: str, folder: Path = Path(), *, is_whole: bool = False) -> Layout:
    """Decode and check a layout; `origin` names the file in messages, and `folder` holds the files that it names.

    With `is_whole` the content is that of `layout_text`, perhaps of an older version: no rate of samples is chosen.
    """
    try:
        document = _with_devices(_with_files(_with_shape(msgspec.toml.decode(content)), folder), folder)
        document = _with_sizes(document, is_whole=is_whole)
    except UNDECODABLE as error:
        raise LayoutError(f"{origin}: expected TOML: {error}") from error
    try:
        layout = msgspec.convert(document, Layout)
    except msgspec.ValidationError as error:
        raise LayoutError(f"{origin}: {in_words(str(error), document, Layout)}") from error
    try:
        _check(layout)
    except LayoutError as error:
        raise LayoutError(f"{origin}: {error}") from error
    return layout


def _with_shape(tables: dict[str, Any]) -> dict[str, Any]:
    """Fill in rows and columns of a shape."""
    taxels = tables.get("taxels")
    shape = taxels.get("shape") if isinstance(taxels, dict) else None
    if isinstance(shape, list) and shape and isinstance(shape[0], str):
        tables["taxels"] = {"rows": len(shape), "columns": len(shape[0])} | tables["taxels"]
    return tables


def _with_files(tables: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Read the files of positions and chains beside a layout, if named: the layout then stands for itself."""
    taxels, measurement = tables.get("taxels", {}), tables.get("measurement", {})
    if not isinstance(taxels, dict) or not isinstance(measurement, dict):
        return tables
    if isinstance(taxels.get("positions"), str):
        taxels["positions"], chains = read_positions(folder / taxels["positions"])
        if chains is not None and "matrix" not in measurement:
            measurement = tables["measurement"] = {"wiring": "file", "chains": chains} | measurement
    if isinstance(measurement.get("matrix"), str):
        measurement["matrix"] = read_matrix(folder / measurement["matrix"])
    if isinstance(matrix := measurement.get("matrix"), list) and all(isinstance(row, str) for row in matrix):
        measurement["matrix"] = [matrix]
    if isinstance(taxels.get("positions"), list):
        tables["taxels"] = {"rows": 1, "columns": len(taxels["positions"])} | taxels
    if isinstance(measurement.get("chains"), str):
        columns = tables.get("taxels", {}).get("columns", Taxels().columns)
        measurement["chains"] = read_chains(folder / measurement["chains"], columns if type(columns) is int else 0)
    if isinstance(measurement.get("chains"), list):
        most = max((len(held) for held in measurement["chains"] if isinstance(held, list)), default=0)
        measurement.setdefault("block_size", min(BOARD_MAX, max(BOARD_MIN, 1 << max(most - 1, 0).bit_length())))
    return tables


def _with_devices(tables: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Fill in the number of nodes of listed node-IDs, and the messages of other devices from their files."""
    buses = tables.get("bus")
    for bus in buses if isinstance(buses, list) else ():
        if isinstance(bus, dict):
            with_foreign_dbc(bus, folder)
            if isinstance(bus.get("node_ids"), list):
                bus.setdefault("nodes", len(bus["node_ids"]))
    return tables


def _with_sizes(tables: dict[str, Any], *, is_whole: bool) -> dict[str, Any]:
    """Fill in the defaults that depend on other keys: rates, sums, buses; see `skin.choice`."""
    sends = SENDINGS.get(str(tables.get("sending")), IN_CYCLES)
    for name, rate_hz in sends.default_rates_hz.items():
        table = tables.setdefault(name, {})
        if isinstance(table, dict):  # else the check of the whole layout names the path
            table.setdefault("rate_hz", rate_hz)
    try:
        taxels = msgspec.convert(tables.get("taxels", {}), Taxels)
        parameters = msgspec.convert(tables.get("measurement", {}), PhiParameters)
    except msgspec.ValidationError:  # the check of the whole layout names the path
        return tables
    if taxels.positions is not None and "pitch_m" not in tables["taxels"]:
        with contextlib.suppress(LayoutError):  # the check of the whole layout names what is wrong
            tables["taxels"]["pitch_m"] = taxels.surface.pitch_m
    if parameters.matrix is not None:
        tables["measurement"].setdefault("sums", max([1, *map(len, parameters.matrix)]))
        tables.setdefault("bus", [])
        return tables
    return _with_choices(tables, parameters, _blocks(taxels, parameters), is_whole=is_whole)


def _with_choices(tables: dict[str, Any], parameters: PhiParameters, blocks: int, *, is_whole: bool) -> dict[str, Any]:
    """Fill in sums, buses, and the rate of samples."""
    sends = SENDINGS.get(str(tables.get("sending")), IN_CYCLES)
    of_block = max(1, parameters.block_size // sends.taxels_per_sum)
    least = blocks * of_block if parameters.rows is None else len(parameters.rows)
    measurement, has_buses = tables.setdefault("measurement", {}), "bus" in tables
    has_sums = "sums" in measurement or parameters.rows is not None
    measurement.setdefault("sums", least)
    if "taxels" not in tables and not has_buses:  # without taxels and buses the file is no layout
        return tables
    most = NODES_PER_BUS if sends.in_cycles else min(NODES_PER_BUS, BUS_SUMS // parameters.block_size)
    fewest = -(-blocks // most)
    tables.setdefault("bus", _even_buses(blocks, fewest))
    try:
        layout = msgspec.convert(tables, Layout)
    except msgspec.ValidationError:  # the check of the whole layout names the path
        return tables
    if not layout.sends.in_cycles or not layout.bus:
        return tables
    if not has_buses:
        counts = range(fewest, min(BUSES_MAX, blocks) + 1)
        spread = (changed(layout, bus=msgspec.convert(_even_buses(blocks, count), list[Bus])) for count in counts)
        layout = next((each for each in spread if carries_enough(each, has_sums=has_sums)), layout)
        tables["bus"] = _even_buses(blocks, len(layout.bus))
    if not has_sums:
        measurement["sums"] = carried_sums(layout)
    sampling = tables.setdefault("sampling", {})
    if sampling.get("rate_hz") == layout.sync.rate_hz:  # one sample a SYNC
        del sampling["rate_hz"]
    elif not is_whole and (averaged := averaged_hz(layout)):
        sampling.setdefault("rate_hz", averaged)
    return tables


def _even_buses(blocks: int, buses: int) -> list[dict[str, Any]]:
    return [{"name": f"bus{each}", "nodes": (blocks + each) // buses} for each in range(buses)]


def _blocks(taxels: Taxels, measurement: PhiParameters) -> int:
    if measurement.chains is not None:
        return len(measurement.chains)
    if measurement.matrix is not None:
        return measurement.sums
    return -(-taxels.there // measurement.block_size)


def validated(layout: Layout) -> Layout:
    """Check a layout that a program has built, and return it with every value in the type of its key."""
    try:
        document = msgspec.to_builtins(layout)
        checked = msgspec.convert(document, Layout)
    except msgspec.ValidationError as error:
        raise LayoutError(in_words(str(error), document, Layout)) from error
    _check(checked)
    return checked


def layout_text(layout: Layout) -> str:
    """Return the layout as TOML; `parse_layout` reads the same layout from it."""
    tables = msgspec.to_builtins(layout)
    # TOML has no null, so such keys are left out. tomli-w would write short tables in lists inline.
    buses = [_bus_text(_given(bus)) for bus in tables.pop("bus")]
    tables = {key: _given(value) if isinstance(value, dict) else value for key, value in _given(tables).items()}
    if layout.samples_per_sync == 1 and averaged_hz(layout):  # a missing key would mean averages
        tables["sampling"] = {"rate_hz": layout.sync.rate_hz}
    if "region" in tables:
        tables["region"] = [_given(each) for each in tables["region"]]
    return "\n[[bus]]\n".join([tomli_w.dumps({key: each for key, each in tables.items() if each != {}}), *buses])


def _bus_text(bus: dict[str, Any]) -> str:
    foreign = bus.pop("foreign")
    return "\n[[bus.foreign]]\n".join(map(tomli_w.dumps, [bus, *map(_given, foreign)]))


def _given(table: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in table.items() if value is not None}


def _check(layout: Layout) -> None:
    """Check keys that depend on each other."""
    _check_shape(layout.taxels)
    if layout.taxels.there < TAXELS_MIN:
        raise LayoutError(f"expected {TAXELS_MIN} taxels or more, got {layout.taxels.there} - at `$.taxels`")
    _check_positions(layout.taxels, layout.measurement)
    _check_untouchable(layout)
    _check_regions(layout)
    if (layout.measurement.ensemble == "matrix") != (layout.measurement.matrix is not None):
        wanted = f"`matrix` and ensemble = 'matrix' belong together, got '{layout.measurement.ensemble}'"
        raise LayoutError(f"{wanted} - at `$.measurement.ensemble`")
    if layout.measurement.matrix is not None:
        _check_matrix(layout)
        return
    _check_measurement(layout)
    if not layout.sends.in_cycles:
        _check_stepped(layout)
    elif layout.steps != Steps():
        raise LayoutError(f'the table needs `sending = "steps"`, got "{layout.sending}" - at `$.steps`')
    sampled_hz = layout.sampling.rate_hz
    if sampled_hz is not None and sampled_hz < layout.sync.rate_hz:
        limit = f"expected {layout.sync.rate_hz:g} (`sync.rate_hz`) or more"
        raise LayoutError(f"{limit}, got {sampled_hz:g} - at `$.sampling.rate_hz`")
    _check_frontend(layout)
    _check_buses(layout)
    if layout.device.first_serial + layout.blocks - 1 > IDENTITY_MAX:
        highest = IDENTITY_MAX - layout.blocks + 1
        raise LayoutError(
            f"expected {highest} or less, for serial numbers of 32 bits, got {layout.device.first_serial}"
            " - at `$.device.first_serial`"
        )


def _check_measurement(layout: Layout) -> None:
    taxels, measurement = layout.taxels, layout.measurement
    size, most = measurement.block_size, layout.places
    if size & (size - 1):
        raise LayoutError(f"expected a power of two, got {size} - at `$.measurement.block_size`")
    if measurement.wiring == "file" and measurement.chains is None:
        raise LayoutError("'file' needs `chains`, or `board` in the file of positions - at `$.measurement.wiring`")
    if measurement.wiring != "file" and measurement.chains is not None:
        raise LayoutError(f"boards from a file need 'file', got '{measurement.wiring}' - at `$.measurement.wiring`")
    if measurement.chains is not None:
        check_chains(measurement.chains, taxels.count, size, taxels.gaps)
    has_gaps = taxels.there < taxels.count
    check_patch(taxels.rows, taxels.columns, size, measurement.wiring, measurement.patch, has_gaps=has_gaps)
    numbers = taxels.count + most - taxels.there  # of taxels and empty places
    if numbers > PLACES_MAX:
        limit = f"expected at most {PLACES_MAX} taxels, gaps and empty places"
        raise LayoutError(f"{limit}, got {numbers} - at `$.measurement`")
    if not 1 <= measurement.sums <= most:
        raise LayoutError(f"expected 1 to {most} sums, got {measurement.sums} - at `$.measurement.sums`")
    if measurement.rows is not None:
        _check_rows(layout, measurement.rows)
    elif measurement.selection == "balanced" and measurement.sums > layout.blocks and measurement.sums % layout.blocks:
        wanted = f"balanced needs fewer sums than the {layout.blocks} blocks, or a multiple of them"
        raise LayoutError(f"{wanted}, got {measurement.sums} - at `$.measurement.sums`")


def _check_matrix(layout: Layout) -> None:
    """Check the matrix, and that no key is given that is of boards."""
    measurement, drawn = layout.measurement, PhiParameters()
    for path, (got, expected) in {
        "sending": (layout.sending, "synchronous"),
        "taxels.frontend": (layout.taxels.frontend, "digital"),
        "sync.turns": (layout.sync.turns, 1),
        "sampling.rate_hz": (layout.sampling.rate_hz, None),
        "bus": (layout.bus, []),
        **{
            f"measurement.{key}": (getattr(measurement, key), getattr(drawn, key))
            for key in ("block_size", "rows", "selection", "seed", "wiring", "chains", "patch")
        },
    }.items():
        if got != expected:
            raise LayoutError(f"{OTHER_HARDWARE}: leave the key out - at `$.{path}`")
    try:
        sums = layout.operator().shape[0]
    except InputError as error:
        raise LayoutError(f"{error} - {KEY}") from error
    if measurement.sums != sums:
        raise LayoutError(
            f"expected {sums}, one for each row, or no key, got {measurement.sums} - at `$.measurement.sums`"
        )


def _check_shape(taxels: Taxels) -> None:
    for number, line in enumerate(taxels.shape or ()):
        if wrong := set(line) - {GAP, TAXEL}:
            signs = f"expected '{TAXEL}' for a taxel and '{GAP}' for a gap"
            raise LayoutError(f"{signs}, got '{min(wrong)}' - at `$.taxels.shape[{number}]`")
        if len(line) != taxels.columns:
            raise LayoutError(f"expected {taxels.columns} signs, got {len(line)} - at `$.taxels.shape[{number}]`")
    if taxels.shape is not None and len(taxels.shape) != taxels.rows:
        raise LayoutError(f"expected {taxels.rows} lines (`rows`), got {len(taxels.shape)} - at `$.taxels.shape`")


def _check_positions(taxels: Taxels, measurement: PhiParameters) -> None:
    count = len(taxels.positions or ())
    if taxels.positions is None:
        if taxels.columns > SIDE_MAX:
            raise LayoutError(f"expected {SIDE_MAX} or less, got {taxels.columns} - at `$.taxels.columns`")
        return
    if (taxels.rows, taxels.columns) != (1, count) or taxels.shape is not None:
        raise LayoutError(
            "taxels at positions are no grid: leave rows, columns and shape out - at `$.taxels.positions`"
        )
    if measurement.patch is not None:
        raise LayoutError("taxels at positions have no regions of a grid: leave the key out - at `$.measurement.patch`")
    try:
        surface = taxels.surface
    except LayoutError as error:
        raise LayoutError(f"{error} - at `$.taxels.positions`") from error
    if not math.isclose(taxels.pitch_m, surface.pitch_m, rel_tol=0.5):
        limit = f"expected the median spacing, {surface.pitch_m:.4g}, or no key"
        raise LayoutError(f"{limit}, got {taxels.pitch_m:g} - at `$.taxels.pitch_m`")


def _check_rows(layout: Layout, rows: Sequence[tuple[int, int]]) -> None:
    measurement = layout.measurement
    if measurement.sums != len(rows):
        limit = f"expected {len(rows)}, one sum for each of `measurement.rows`, or no `sums`"
        raise LayoutError(f"{limit}, got {measurement.sums} - at `$.measurement.sums`")
    if measurement.selection != "balanced":
        raise LayoutError("named rows are not drawn: leave `selection` or `rows` out - at `$.measurement.selection`")
    try:
        of_rows(sbhe(layout.taxels.there, layout.blocks, block_size=measurement.block_size, blocks=layout.blocks), rows)
    except InputError as error:
        raise LayoutError(f"{error} - at `$.measurement.rows`") from error


def _check_frontend(layout: Layout) -> None:
    """Check what an analogue front end needs: sums in each cycle, no averages of taxels, enough codes."""
    if not layout.taxels.is_analogue:
        return
    if layout.samples_per_sync > 1:
        raise LayoutError(
            "an analogue front end has no taxels to average: leave the key out, or expected"
            f" {layout.sync.rate_hz:g} (`sync.rate_hz`), got {layout.sampling.rate_hz:g} - at `$.sampling.rate_hz`"
        )
    if layout.taxels.adc_bits < ANALOGUE_BITS:
        limits = f"an analogue front end expects {ANALOGUE_BITS} or more"
        raise LayoutError(f"{limits}, got {layout.taxels.adc_bits} - at `$.taxels.adc_bits`")


def _check_untouchable(layout: Layout) -> None:
    taxels, count = layout.taxels.untouchable or (), layout.taxels.count
    outside = [taxel for taxel in taxels if not 0 <= taxel < count]
    twice = [taxel for taxel, times in Counter(taxels).items() if times > 1]
    if outside or twice or not set(range(count)) - set(taxels) - set(layout.taxels.gaps.tolist()):
        wrong = f"{outside[0]}" if outside else f"{twice[0]} twice" if twice else "all taxels"
        limit = f"expected some of the taxels 0 to {count - 1}, each once and not all"
        raise LayoutError(f"{limit}, got {wrong} - at `$.taxels.untouchable`")


def _check_regions(layout: Layout) -> None:
    from skin.regions import regions_of  # it needs the tables above

    given = layout.region or []
    names = [each.name for each in given]
    if twice := [name for name, times in Counter(names).items() if times > 1]:
        raise LayoutError(f"region name '{twice[0]}' is used twice - at `$.region`")
    if given:
        regions_of(layout)


def _check_stepped(layout: Layout) -> None:
    """Check what boards that send steps need: a patch of `STEPPED_SIZES` taxels each, their rates, whole slots."""
    measurement = layout.measurement
    size = measurement.block_size
    if size not in STEPPED_SIZES:
        sizes = " or ".join(map(str, STEPPED_SIZES))
        raise LayoutError(f"{_OF_STEPS} {sizes}, got {size} - at `$.measurement.block_size`")
    wanted = {
        "taxels.frontend": (layout.taxels.frontend, "digital"),
        "measurement.wiring": (measurement.wiring, "file" if measurement.chains else "board"),
        "measurement.sums": (measurement.sums, layout.places),
        "sync.turns": (layout.sync.turns, 1),
        "sampling.rate_hz": (layout.sampling.rate_hz, layout.sends.default_rates_hz["sampling"]),
    }
    for path, (got, expected) in wanted.items():
        if got != expected:
            raise LayoutError(f"{_OF_STEPS} {expected!r}, got {got!r} - at `$.{path}`")
    slots, period_s = layout.slots, layout.sync.period_s
    if not 1 <= slots <= SYNC_OVERFLOW or not math.isclose(slots * layout.steps.slot_s, period_s, rel_tol=_SLOT_ERROR):
        limits = f"expected {period_s:g} (1 / `sync.rate_hz`) or a whole part of it, down to 1/{SYNC_OVERFLOW}"
        nearest_s = period_s / min(max(1, slots), SYNC_OVERFLOW)
        raise LayoutError(f"{limits}, such as {nearest_s:.9g}, got {layout.steps.slot_s:.9g} - at `$.steps.slot_s`")
    if layout.steps.at_sync and slots > 1:
        limits = f"boards that send at SYNC expect {1 / layout.steps.slot_s:g} (1 / `steps.slot_s`)"
        raise LayoutError(f"{limits}, got {layout.sync.rate_hz:g} - at `$.sync.rate_hz`")
    for index, bus in enumerate(layout.bus):
        if bus.blocks_per_node != 1:
            limits = f"{_OF_STEPS} nodes of one block"
            raise LayoutError(f"{limits}, got nodes of {bus.blocks_per_node} - at `$.bus[{index}].blocks_per_node`")


def _check_buses(layout: Layout) -> None:
    if not layout.bus:
        raise LayoutError("expected 1 table or more, got 0 - at `$.bus`")
    names = [bus.name for bus in layout.bus]
    for index, name in enumerate(names):
        if name in names[:index]:
            raise LayoutError(f"bus name '{name}' is used twice - at `$.bus[{index}].name`")
        bus = layout.bus[index]
        if bus.data_bitrate is not None and not bus.fd:
            raise LayoutError(f"a data bit rate needs `fd = true` - at `$.bus[{index}].data_bitrate`")
        if bus.data_bitrate is not None and bus.data_bitrate < bus.bitrate:
            limit = f"expected {bus.bitrate} (`bitrate`) or more"
            raise LayoutError(f"{limit}, got {bus.data_bitrate} - at `$.bus[{index}].data_bitrate`")
        _check_node_ids(bus, f"$.bus[{index}]")
        check_foreign(bus.foreign, f"$.bus[{index}].foreign", is_fd=bus.fd)
    blocks = layout.first_block(len(layout.bus))
    if blocks != layout.blocks:
        held = f"the buses' nodes hold {blocks} blocks (`nodes` x `blocks_per_node`)"
        raise LayoutError(f"{held} but the skin has {layout.blocks} - at `$.bus`")


def _check_node_ids(bus: Bus, path: str) -> None:
    if bus.node_ids is not None and bus.first_node_id is not None:
        raise LayoutError(f"expected `first_node_id` or `node_ids`, got both - at `{path}.node_ids`")
    if bus.node_ids is not None and list(bus.node_ids) != sorted(set(bus.node_ids)):
        raise LayoutError(f"expected node-IDs in ascending order, each once, got {bus.node_ids} - at `{path}.node_ids`")
    if len(bus.ids) != bus.nodes:
        raise LayoutError(
            f"expected {bus.nodes} node-IDs (`nodes`), or no `nodes`, got {len(bus.ids)} - at `{path}.node_ids`"
        )
    if bus.ids[-1] > NODES_MAX:
        limit = f"expected {NODES_MAX + 1 - bus.nodes} or less, for {bus.nodes} node-IDs up to {NODES_MAX}"
        raise LayoutError(f"{limit}, got {bus.first_node_id} - at `{path}.first_node_id`")
