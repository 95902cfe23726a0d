"""Search for a layout that meets a requirement: few buses first, then slow data phases, wide sums, small nodes."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import chain, product
from typing import Final, Literal

import msgspec

from bandwidth.highest_rate import highest_rate_hz
from bandwidth.plan import bus_time, plan_bus, touched_load
from bandwidth.response import UNBOUNDED
from bandwidth.traffic import Disturbance, traffic
from canskin.errors import InputError, LayoutError
from dbc.canopen import HIGHEST_NODE_ID
from dbc.contract import Contract, useful_widths
from dbc.dictionary import window_s
from skin.choice import BUSES_MAX, COMPRESSIONS, ROOM, averaged_hz
from skin.layout import (
    GAP,
    RATE_MAX_HZ,
    SUM_BITS_MAX,
    SUM_BITS_MIN,
    TAXEL,
    Bus,
    Layout,
    PhiParameters,
    Sync,
    Taxels,
    changed,
    validated,
)
from skin.ways_of_sending import STEPPED, SendingName

CanKind = Literal["any", "classic", "fd"]
SendingKind = Literal["any", "synchronous", "steps"]

#: Data bit rates of CAN FD, and blocks per node, to try.
FD_BITRATES: Final = (2_000_000, 5_000_000, 8_000_000)
BLOCKS_PER_NODE: Final = (1, 2, 4, 8)
#: Widths to try. The rounding of 9 bits is nearly the noise of averages of ten, so 9 bits and fewer come last.
_WIDTHS: Final = (range(SUM_BITS_MAX, 9, -1), range(9, SUM_BITS_MIN - 1, -1))
DATA_BITRATES: Final[dict[CanKind, tuple[int | None, ...]]] = {
    "classic": (None,),
    "fd": FD_BITRATES,
    "any": (None, *FD_BITRATES),
}
#: Fastest data phase of every CAN FD transceiver (ISO 11898-2:2016): the limit of the search for more sums.
COMMON_DATA_BITRATE: Final = 5_000_000
TAXELS_MIN, TAXELS_MAX = 64, 65536


@dataclass(frozen=True)
class Requirement:
    """Requirement of a layout; InputError refuses numbers out of range.

    Attributes
    ----------
    taxels : int or Taxels
        Their number, on a grid that is nearly square, or the grid.
    rate_hz : float
        Measurements per second.
    buses : int
        Largest number of buses.
    budget : float
        Highest load of a bus, with the most stuff bits.
        Of steps, which fill a bus when everything moves, the load under simulated touches.
    can : {"any", "classic", "fd"}
    sending : {"any", "synchronous", "steps"}
        ``any``: synchronous sums, whose load and lateness have a bound; steps where these do not fit.
    """

    taxels: int | Taxels
    rate_hz: float
    buses: int = 4
    budget: float = ROOM
    can: CanKind = "any"
    sending: SendingKind = "any"

    def __post_init__(self) -> None:
        if not TAXELS_MIN <= self.count <= TAXELS_MAX:
            raise InputError(f"expected {TAXELS_MIN} to {TAXELS_MAX} taxels, got {self.count}")
        if not 0 < self.rate_hz <= RATE_MAX_HZ:
            raise InputError(f"expected a rate above 0 and up to {RATE_MAX_HZ:g} Hz, got {self.rate_hz:g}")
        if not 1 <= self.buses <= BUSES_MAX:
            raise InputError(f"expected 1 to {BUSES_MAX} buses, got {self.buses}")
        if not 0 < self.budget <= 1:
            raise InputError(f"expected a budget above 0 and up to 1, the part of each bus to use, got {self.budget:g}")

    @property
    def count(self) -> int:
        """Number of taxels."""
        return self.taxels.there if isinstance(self.taxels, Taxels) else self.taxels

    @property
    def grid(self) -> Taxels:
        """The taxels."""
        return self.taxels if isinstance(self.taxels, Taxels) else nearly_square(self.taxels)


def nearly_square(count: int) -> Taxels:
    """Return a grid of a number of taxels: at most twice as high as wide, with gaps in the last row if need be."""
    columns = next((each for each in range(math.isqrt(count), 0, -1) if count % each == 0), 1)
    if count // columns <= 2 * columns:
        return Taxels(rows=count // columns, columns=columns)
    columns = math.isqrt(count)
    signs = (TAXEL * count).ljust(-(-count // columns) * columns, GAP)
    shape = tuple(signs[first : first + columns] for first in range(0, len(signs), columns))
    return Taxels(shape=shape, rows=len(shape), columns=columns)


@dataclass(frozen=True)
class Candidate:
    """A layout that was tried; fields ``missing_…`` tell what it lacks: 0 for nothing, None if unknown.

    `load_touched` and `late_random_ms` are of steps, see `bandwidth.plan.BusPlan`.
    """

    sending: SendingName
    buses: int
    nodes: int
    blocks_per_node: int
    sums: int
    sum_bits: int
    data_bitrate: int | None
    missing_node_ids: int
    load_worst: float | None = None
    window_needed_ms: float | None = None
    missing_bits_per_s: float | None = None
    missing_window_ms: float | None = None
    problem: str | None = None
    load_touched: float | None = None
    late_random_ms: float | None = None

    @property
    def fits(self) -> bool:
        """Whether the layout meets the requirement."""
        return self.problem is None

    @property
    def words(self) -> str:
        """Buses, nodes and sums as text."""
        wire = "classic CAN" if self.data_bitrate is None else f"CAN FD {self.data_bitrate // 1_000_000} Mbit/s"
        buses = f"{self.buses} bus{'es' * (self.buses > 1)}"
        each = f"{self.blocks_per_node} block{'s' * (self.blocks_per_node > 1)}"
        sums = f"{self.sums} sums" + (f" of {self.sum_bits} bits" if self.sending == "synchronous" else ", stepped")
        return f"{buses} of {wire}, {self.nodes} nodes of {each}, {sums}"

    @property
    def load_words(self) -> str:
        """The load of each bus as text."""
        if self.load_touched is None:
            return f"each bus {self.load_worst or 0:.1%} full at worst"
        late = "" if self.late_random_ms is None else f", frames end within {self.late_random_ms:.1f} ms"
        moved = f"{self.load_worst or 0:.1%} at worst when everything moves{late}"
        return f"each bus {self.load_touched:.1%} full under simulated touches, {moved}"


@dataclass(frozen=True)
class Search:
    """Result of a search: all layouts that were tried, and the chosen layout if any fits."""

    required: Requirement
    allowed: Disturbance
    candidates: list[Candidate]
    chosen: Candidate | None
    layout: Layout | None

    def missing(self) -> str | None:
        """Return what the nearest layout lacks, its highest rate, and how many lack node-IDs; None if a layout fits."""
        if self.layout is not None:
            return None
        required, seen = self.required, self.candidates
        most = "1 bus" if required.buses == 1 else f"up to {required.buses} buses"
        kind = {"any": "CAN or CAN FD", "classic": "classic CAN", "fd": "CAN FD"}[required.can]
        asked = f"{required.count} taxels {required.rate_hz:g} times a second"
        lines = [f"no layout carries {asked} over {most} of {kind}, each at most {required.budget:.0%} full"]
        nearest = self.nearest_in_cycles()
        lines += [nearest] if nearest else []
        short = [each for each in seen if each.missing_node_ids]
        if short:
            least = min(short, key=lambda each: each.missing_node_ids)
            lines.append(
                f"{len(short)} of {len(seen)} lack node-IDs, {least.missing_node_ids} of them or more on a bus"
            )
        if not nearest and not short:
            lines += [f"{each.words}: {each.problem}" for each in seen[-1:]]
        return "; ".join(lines)

    def nearest_in_cycles(self) -> str | None:
        """Return what the nearest layout of synchronous sums that does not fit lacks; None if none was judged."""
        judged = [
            (each, layout)
            for each, layout in zip(self.candidates, _layouts(self.required), strict=False)
            if each.load_worst is not None and each.sending == "synchronous" and not each.fits
        ]
        if not judged:
            return None
        nearest, layout = min(judged, key=lambda each: each[0].load_worst or 0.0)
        rate_hz = highest_rate_hz(layout, self.required.budget, self.allowed)
        would = f"it fits at up to {rate_hz:g} Hz" if rate_hz else "it fits at no rate"
        most_s = self.allowed.of(layout).jitter_s or 0.0
        sooner_s = math.floor(1e4 * most_s - 10 * (nearest.missing_window_ms or 0.0)) / 1e4
        if 0 < sooner_s < most_s and _judge(layout, self.required, replace(self.allowed, jitter_s=sooner_s)).fits:
            would += f", and here with boards that answer within {1e3 * sooner_s:g} ms (--jitter-s {sooner_s:g})"
        return f"the nearest, {nearest.words}, lacks: {nearest.problem}; {would}"


def search(
    required: Requirement, allowed: Disturbance | None = None, tell: Callable[[Candidate], None] = lambda _: None
) -> Search:
    """Search for the first layout that meets a requirement, then for more sums on the same buses and nodes.

    `tell` is called with each layout that was tried.

    The smallest number of taxels per sum of `COMPRESSIONS` that fits is taken. For more sums the data phase of CAN FD
    may become faster, up to `COMMON_DATA_BITRATE`.
    """
    allowed = allowed or Disturbance()
    candidates: list[Candidate] = []

    def fits(layout: Layout) -> bool:
        candidates.append(_judge(layout, required, allowed))
        tell(candidates[-1])
        return candidates[-1].fits

    least = next(filter(fits, _layouts(required)), None)
    if least is not None and not least.sends.in_cycles:
        return Search(required, allowed, candidates, candidates[-1], least)
    if least is None:
        return Search(required, allowed, candidates, None, None)
    chosen = candidates[-1]
    denser = next(filter(fits, _denser(least)), None)
    return Search(required, allowed, candidates, chosen if denser is None else candidates[-1], denser or least)


def _layouts(required: Requirement) -> Iterator[Layout]:
    """Yield the layouts to try, synchronous sums first, least hardware first."""
    start = Layout(
        taxels=required.grid,
        measurement=PhiParameters(),
        sync=Sync(rate_hz=required.rate_hz),
        bus=[Bus(name="bus0", nodes=1)],
    )
    start = changed(start, measurement={"sums": start.places // COMPRESSIONS[0]})
    if required.sending != "steps":
        yield from _in_cycles(changed(start, sampling={"rate_hz": averaged_hz(start)}), required)
    if required.sending != "synchronous" and required.rate_hz <= STEPPED.default_rates_hz["sampling"]:
        yield from _in_steps(start, required)


def _in_cycles(start: Layout, required: Requirement) -> Iterator[Layout]:
    ways = (
        product(range(1, required.buses + 1), DATA_BITRATES[required.can], bits, BLOCKS_PER_NODE) for bits in _WIDTHS
    )
    for buses, rate, bits, per_node in chain.from_iterable(ways):
        sums = -(-start.measurement.sums // start.blocks) * per_node
        if start.blocks % per_node or bits not in useful_widths(sums, fd=rate is not None):
            continue
        if start.blocks // per_node >= buses:
            like = msgspec.structs.replace(
                start.bus[0], fd=rate is not None, data_bitrate=rate, blocks_per_node=per_node
            )
            yield changed(with_buses(start, buses, like), encoding={"sum_bits": bits})


def _in_steps(start: Layout, required: Requirement) -> Iterator[Layout]:
    """Yield layouts of steps: a patch of neighbours on a node, and all its sums."""
    rates = {table: {"rate_hz": rate_hz} for table, rate_hz in STEPPED.default_rates_hz.items()}
    start = changed(start, sending="steps", measurement={"sums": start.places, "wiring": "board"}, **rates)
    for buses, rate in product(range(1, required.buses + 1), DATA_BITRATES[required.can]):
        if start.blocks >= buses:
            yield with_buses(
                start, buses, msgspec.structs.replace(start.bus[0], fd=rate is not None, data_bitrate=rate)
            )


def with_buses(layout: Layout, buses: int, like: Bus) -> Layout:
    """Return the layout with its blocks divided evenly over `buses` buses with the settings of `like`."""
    nodes = -(-layout.blocks // like.blocks_per_node)
    like = msgspec.structs.replace(
        like, first_node_id=like.ids[0] if like.node_ids else like.first_node_id, node_ids=None
    )
    share = [nodes // buses + (each < nodes % buses) for each in range(buses)]
    lines = [
        msgspec.structs.replace(like, name=f"bus{number}", nodes=count) for number, count in enumerate(share) if count
    ]
    return changed(layout, bus=lines)


def _denser(least: Layout) -> Iterator[Layout]:
    """Yield layouts of the same buses and nodes with more sums: most sums first, then slow bit rates first."""
    first = least.bus[0]
    rates = [first.data_bitrate]
    if first.data_bitrate is not None:
        rates += [rate for rate in FD_BITRATES if first.data_bitrate < rate <= COMMON_DATA_BITRATE]
    for taxels_per_sum, rate in product(COMPRESSIONS[:0:-1], rates):
        dense = changed(least, measurement={"sums": least.places // taxels_per_sum})
        yield with_buses(dense, len(least.bus), msgspec.structs.replace(first, data_bitrate=rate))


def _judge(layout: Layout, required: Requirement, allowed: Disturbance) -> Candidate:
    first = layout.bus[0]  # no other bus has more nodes
    missing_ids = max(0, first.nodes - HIGHEST_NODE_ID)
    about = Candidate(
        sending=layout.sending,
        buses=len(layout.bus),
        nodes=sum(bus.nodes for bus in layout.bus),
        blocks_per_node=first.blocks_per_node,
        sums=layout.measurement.sums,
        sum_bits=layout.encoding.sum_bits,
        data_bitrate=first.data_bitrate,
        missing_node_ids=missing_ids,
    )
    if missing_ids:
        return replace(about, problem=f"{missing_ids} node-IDs ({first.nodes} nodes on a bus of {HIGHEST_NODE_ID})")
    try:
        contract = Contract.from_layout(validated(layout))
    except LayoutError as error:
        return replace(about, problem=str(error))
    return (_judge_steps if contract.in_steps else _judge_cycles)(about, contract, required, allowed)


def _judge_cycles(about: Candidate, contract: Contract, required: Requirement, allowed: Disturbance) -> Candidate:
    window_ms = window_s(contract.layout) * 1e3
    streams = traffic(contract, 0, allowed=allowed)
    load = bus_time(streams, "worst").load(required.rate_hz)
    response = int(streams.responses_ns(allowed.errors_per_s)[streams.is_tpdo].max())
    needed_ms = response * 1e-6 if response < UNBOUNDED else None
    missing_bits = max(0.0, (load - required.budget) * contract.layout.bus[0].bitrate)
    missing_ms = max(0.0, needed_ms - window_ms) if needed_ms is not None else None
    return replace(
        about,
        load_worst=load,
        window_needed_ms=needed_ms,
        missing_bits_per_s=missing_bits,
        missing_window_ms=missing_ms,
        problem=", ".join(_lacks(missing_bits, load, missing_ms, window_ms)) or None,
    )


def _judge_steps(about: Candidate, contract: Contract, required: Requirement, allowed: Disturbance) -> Candidate:
    plan = plan_bus(contract, 0, None, allowed)
    about = replace(about, load_worst=plan.load_worst, late_random_ms=plan.late_random_ms)
    if plan.problems:
        return replace(about, problem="; ".join(plan.problems))
    load = (plan.load_rest or 0.0) + touched_load(contract, 0)
    missing_bits = max(0.0, (load - required.budget) * plan.bitrate)
    lacks = _lacks(missing_bits, load, 0.0, 0.0)
    return replace(about, load_touched=load, missing_bits_per_s=missing_bits, problem=", ".join(lacks) or None)


def _lacks(missing_bits: float, load: float, missing_ms: float | None, window_ms: float) -> list[str]:
    found = []
    if missing_bits > 0:
        found.append(f"{missing_bits:.0f} bits a second on each bus (it would be {load:.1%} full)")
    if missing_ms is None:
        found.append("a window of any length (1007h): TPDOs of one cycle would still be sent in the next")
    elif missing_ms > 0:
        found.append(
            f"{missing_ms:.2f} ms of window (1007h, {window_ms:.2f} ms), or boards that answer sooner (--jitter-s)"
        )
    return found
