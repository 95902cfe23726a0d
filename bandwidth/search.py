"""Search for the layout that meets a wish with the least: few buses, slow wires, wide sums, small nodes."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain, product
from typing import Final, Literal

import msgspec

from bandwidth.alternatives import with_bits, with_buses
from bandwidth.highest import highest_rate_hz
from bandwidth.layout_text import layout_text
from bandwidth.plan import counted_wire
from bandwidth.response import UNBOUNDED
from bandwidth.traffic import Disturbance, traffic
from dbc.canopen import HIGHEST_NODE_ID
from dbc.contract import Contract
from dbc.dictionary import WINDOW_RATIO
from skin.errors import InputError, LayoutError
from skin.layout import Bus, Layout, Measuring, Sync, Taxels, parse_layout

Kind = Literal["any", "classic", "fd"]

#: Widths to try: rounding to 8 bits is no longer small beside the sensor noise, so that all else is tried first.
SUM_BITS: Final = ((16, 12), (8,))
BLOCKS_PER_NODE: Final = (1, 2, 4, 8)
DATA_BITRATES: Final = {
    "classic": (None,),
    "fd": (2_000_000, 5_000_000, 8_000_000),
    "any": (None, 2_000_000, 5_000_000, 8_000_000),
}
#: One sum for so many taxels.
COMPRESSION: Final = 4
TAXELS_MIN, TAXELS_MAX = 64, 65536
BUSES_MAX: Final = 16


@dataclass(frozen=True)
class Wish:
    """So many taxels, `rate_hz` times a second, over at most `buses`, each at most `budget` full at worst."""

    taxels: int
    rate_hz: float
    buses: int = 4
    budget: float = 0.8
    can: Kind = "any"

    def check(self) -> None:
        """Refuse what no layout can be.

        Raises
        ------
        InputError
            If a number is out of range.
        """
        if not TAXELS_MIN <= self.taxels <= TAXELS_MAX or self.taxels & self.taxels - 1:
            raise InputError(f"expected a power of two from {TAXELS_MIN} to {TAXELS_MAX} taxels, got {self.taxels}")
        if not 0 < self.rate_hz <= 2000:
            raise InputError(f"expected a rate above 0 and up to 2000 Hz, got {self.rate_hz:g}")
        if not 1 <= self.buses <= BUSES_MAX:
            raise InputError(f"expected 1 to {BUSES_MAX} buses, got {self.buses}")
        if not 0 < self.budget <= 1:
            raise InputError(f"expected a budget above 0 and up to 1, the part of each bus to use, got {self.budget:g}")


@dataclass(frozen=True)
class Candidate:
    """A layout that was looked at; missing is what it lacks, 0 for nothing, None when that cannot be said."""

    buses: int
    nodes: int
    blocks_per_node: int
    sum_bits: int
    data_bitrate: int | None
    load_worst: float | None
    window_needed_ms: float | None
    missing_bits_per_s: float | None
    missing_node_ids: int
    missing_window_ms: float | None
    problem: str | None

    @property
    def fits(self) -> bool:
        """Whether it meets the wish."""
        return self.problem is None

    @property
    def words(self) -> str:
        """What it is, in words."""
        wire = "classic CAN" if self.data_bitrate is None else f"CAN FD {self.data_bitrate // 1_000_000} Mbit/s"
        buses = f"{self.buses} bus{'es' * (self.buses > 1)}"
        each = f"{self.blocks_per_node} block{'s' * (self.blocks_per_node > 1)}"
        return f"{buses} of {wire}, {self.nodes} nodes of {each}, {self.sum_bits}-bit sums"


def search(wish: Wish, allowed: Disturbance | None = None) -> tuple[Layout | None, list[Candidate]]:
    """Return the first layout that meets a wish, and all that were looked at until then.

    Raises
    ------
    InputError
        If the wish is out of range.
    """
    wish.check()
    seen = []
    for layout in _layouts(wish):
        candidate = _judge(layout, wish, allowed or Disturbance())
        seen.append(candidate)
        if candidate.fits:
            return layout, seen
    return None, seen


def what_is_missing(wish: Wish, seen: list[Candidate], allowed: Disturbance | None = None) -> str:
    """Say why no layout met a wish: what the nearest one lacks, at which rate it fits, and how many lacked node-IDs."""
    judged = [each for each in seen if each.load_worst is not None]
    most = "1 bus" if wish.buses == 1 else f"up to {wish.buses} buses"
    kind = "CAN or CAN FD" if wish.can == "any" else f"{wish.can} CAN" if wish.can == "classic" else "CAN FD"
    asked = f"{wish.taxels} taxels {wish.rate_hz:g} times a second"
    lines = [f"no layout carries {asked} over {most} of {kind}, each at most {wish.budget:.0%} full"]
    if judged:
        nearest = min(judged, key=lambda each: each.load_worst or 0.0)
        layout = next(layout for layout, each in zip(_layouts(wish), seen, strict=False) if each is nearest)
        rate_hz = highest_rate_hz(layout, wish.budget, allowed)
        would = f"; it fits at up to {rate_hz:g} Hz" if rate_hz else "; it fits at no rate"
        lines.append(f"the nearest, {nearest.words}, lacks: {nearest.problem}{would}")
    short = [each for each in seen if each.missing_node_ids]
    if short:
        least = min(short, key=lambda each: each.missing_node_ids)
        lines.append(f"{len(short)} of {len(seen)} lack node-IDs, {least.missing_node_ids} of them or more on a bus")
    return "; ".join(lines)


def _layouts(wish: Wish) -> Iterator[Layout]:
    """Yield what is worth looking at, the least first."""
    power = wish.taxels.bit_length() - 1
    rows, columns = 1 << (power + 1) // 2, 1 << power // 2
    start = Layout(
        taxels=Taxels(rows=rows, columns=columns),
        measurement=Measuring(sums=wish.taxels // COMPRESSION),
        sync=Sync(rate_hz=wish.rate_hz),
        bus=[Bus(name="bus0", nodes=1)],
    )
    ways = (product(range(1, wish.buses + 1), DATA_BITRATES[wish.can], bits, BLOCKS_PER_NODE) for bits in SUM_BITS)
    for buses, rate, bits, per_node in chain.from_iterable(ways):
        if start.blocks % per_node == 0 and start.blocks // per_node >= buses:
            like = msgspec.structs.replace(
                start.bus[0], fd=rate is not None, data_bitrate=rate, blocks_per_node=per_node
            )
            yield with_bits(with_buses(start, buses, like), bits)


def _judge(layout: Layout, wish: Wish, allowed: Disturbance) -> Candidate:
    first = layout.bus[0]  # no other has more nodes
    window_ms = WINDOW_RATIO * layout.sync.period_s * 1e3
    load = needed_ms = missing_bits = missing_ms = None
    missing_ids = max(0, first.nodes - HIGHEST_NODE_ID)
    problems = []
    if missing_ids:
        problems.append(f"{missing_ids} node-IDs ({first.nodes} nodes on a bus of {HIGHEST_NODE_ID})")
    else:
        try:
            contract = Contract.from_layout(parse_layout(layout_text(layout).encode(), "wish"))
        except LayoutError as error:
            problems.append(str(error))
        else:
            streams = traffic(contract, 0, allowed=allowed)
            load = counted_wire(streams, "worst").load(wish.rate_hz)
            response = int(streams.responses_ns(allowed.errors_per_s)[streams.is_tpdo].max())
            needed_ms = response * 1e-6 if response < UNBOUNDED else None
            missing_bits = max(0.0, (load - wish.budget) * first.bitrate)
            missing_ms = max(0.0, needed_ms - window_ms) if needed_ms is not None else None
            problems += _lacks(missing_bits, load, missing_ms, window_ms)
    return Candidate(
        buses=len(layout.bus),
        nodes=sum(bus.nodes for bus in layout.bus),
        blocks_per_node=first.blocks_per_node,
        sum_bits=layout.encoding.sum_bits,
        data_bitrate=first.data_bitrate,
        load_worst=load,
        window_needed_ms=needed_ms,
        missing_bits_per_s=missing_bits,
        missing_node_ids=missing_ids,
        missing_window_ms=missing_ms,
        problem=", ".join(problems) or None,
    )


def _lacks(missing_bits: float, load: float, missing_ms: float | None, window_ms: float) -> list[str]:
    found = []
    if missing_bits > 0:
        found.append(f"{missing_bits:.0f} bits a second on each bus (it would be {load:.1%} full)")
    if missing_ms is None:
        found.append("a window of any length (1007h): TPDOs of one cycle would still be sent in the next")
    elif missing_ms > 0:
        found.append(f"{missing_ms:.2f} ms of window (1007h, {window_ms:.2f} ms)")
    return found
