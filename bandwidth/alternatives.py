"""Plans of layouts that differ from a given layout in one key."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import msgspec

from bandwidth.plan import BusPlan, plan_bus
from bandwidth.traffic import Disturbance
from canskin.errors import SkinError
from dbc.contract import Contract, useful_widths
from dbc.packing import rounding_error_n
from skin.choice import averaged_hz
from skin.layout import Bus, Layout, changed, validated

#: Data bit rates of CAN FD, and blocks per node, that are compared.
FD_BITRATES: Final = (2_000_000, 5_000_000, 8_000_000)
BLOCKS_PER_NODE: Final = (1, 2, 4, 8)
#: Blocks per node whose 16-bit sums fill a CAN FD frame.
FD_BLOCKS: Final = 4


@dataclass(frozen=True)
class Alternative:
    """A changed layout; figures of the bus with the highest load, None with a `problem` for an impossible layout."""

    change: str
    buses: int
    nodes: int
    sum_bits: int
    rounding_error_n: float | None
    frames_per_cycle: int | None
    load_random: float | None
    load_worst: float | None
    max_rate_hz_random: float | None
    max_rate_hz_worst: float | None
    window_needed_ms: float | None
    problem: str | None


def alternatives(layout: Layout, allowed: Disturbance | None = None) -> Iterator[Alternative]:
    """Yield the given layout, then layouts with other buses, widths and numbers of sums, blocks per node, or CAN FD."""
    allowed = allowed or Disturbance()
    for change, other in _changes(layout):
        yield _judge(change, other, allowed)


def _changes(layout: Layout) -> Iterator[tuple[str, Layout]]:
    yield "as it is", layout
    buses, first = len(layout.bus), layout.bus[0]
    yield f"{2 * buses} buses", with_buses(layout, 2 * buses, first)
    for bits in useful_widths(-(-layout.measurement.sums // layout.blocks) * first.blocks_per_node, fd=first.fd):
        if bits < layout.encoding.sum_bits:
            yield f"{bits}-bit sums", changed(layout, encoding={"sum_bits": bits})
    sums = layout.measurement.sums
    is_drawn = layout.measurement.rows is None  # named rows have one number of sums
    if is_drawn and 2 * sums <= layout.places:
        yield f"{2 * sums} sums", changed(layout, measurement={"sums": 2 * sums})
    if is_drawn and sums % (2 * layout.blocks) == 0:
        yield f"{sums // 2} sums", changed(layout, measurement={"sums": sums // 2})
    for per_node in BLOCKS_PER_NODE:
        if per_node > first.blocks_per_node and layout.blocks % per_node == 0:
            larger = msgspec.structs.replace(first, blocks_per_node=per_node)
            yield f"{per_node} blocks per node", with_buses(layout, buses, larger)
    for per_node in sorted({first.blocks_per_node, FD_BLOCKS}):
        for rate in FD_BITRATES if layout.blocks % per_node == 0 else ():
            fast = msgspec.structs.replace(first, fd=True, data_bitrate=rate, blocks_per_node=per_node)
            if fast != first:
                yield f"CAN FD {rate // 1_000_000} Mbit/s, {per_node} per node", with_buses(layout, buses, fast)


def with_averages(layout: Layout, most: int | None = None) -> Layout:
    """Return the layout of boards in cycles that average, see `skin.choice.averaged_hz`."""
    return changed(layout, sampling={"rate_hz": averaged_hz(layout, most)})


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


def planned(layout: Layout, allowed: Disturbance) -> list[BusPlan]:
    """Check and plan a layout that a program has built, without simulated touches."""
    contract = Contract.from_layout(validated(layout))
    return [plan_bus(contract, bus, None, allowed) for bus in range(len(layout.bus))]


def _judge(change: str, layout: Layout, allowed: Disturbance) -> Alternative:
    nodes = sum(bus.nodes for bus in layout.bus)
    try:
        plans = planned(layout, allowed)
    except SkinError as error:
        empty = (None,) * 7
        return Alternative(change, len(layout.bus), nodes, layout.encoding.sum_bits, *empty, problem=str(error))
    fullest = max(plans, key=lambda each: each.load_worst)
    return Alternative(
        change=change,
        buses=len(layout.bus),
        nodes=nodes,
        sum_bits=layout.encoding.sum_bits,
        rounding_error_n=rounding_error_n(layout),
        frames_per_cycle=sum(each.frames_per_cycle for each in plans),
        load_random=fullest.load_random,
        load_worst=fullest.load_worst,
        max_rate_hz_random=fullest.max_rate_hz_random,
        max_rate_hz_worst=fullest.max_rate_hz_worst,
        window_needed_ms=fullest.window_needed_ms,
        problem="; ".join(problem for each in plans for problem in each.problems) or None,
    )
