"""The rules that the keys of a layout keep together; `skin.layout` has the rules of single keys."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from canskin.errors import InputError, LayoutError
from skin.measurement import of_rows
from skin.wiring import check_patch

if TYPE_CHECKING:
    from skin.layout import Layout, Recognition

#: Adaptive sending: taxels of a block, and nodes of a bus: each has 32 identifiers of its own, and on CAN FD 8.
ADAPTIVE_BLOCK: Final = 32
ADAPTIVE_NODES: Final = 32
ADAPTIVE_FD_NODES: Final = 127
#: Fewest bits of a converter of sums: its two end codes count as saturated.
ANALOGUE_BITS: Final = 4
#: Most nodes of a bus with recognition: an identifier of one more switches the state of all.
RECOGNITION_NODES: Final = 126
#: Largest value of an entry of the identity object (1018h).
IDENTITY_MAX: Final = 2**32 - 1


def check(layout: "Layout") -> None:
    """Check keys that depend on each other.

    Raises
    ------
    LayoutError
        If a value is not allowed beside the others; the message names the path of the key.
    """
    _check_measurement(layout)
    if not layout.sends.in_cycles:
        _check_adaptive(layout)
    sampled_hz = layout.sampling.rate_hz
    if sampled_hz is not None and sampled_hz < layout.sync.rate_hz:
        limit = f"expected {layout.sync.rate_hz:g} (`sync.rate_hz`) or more"
        raise LayoutError(f"{limit}, got {sampled_hz:g} - at `$.sampling.rate_hz`")
    _check_frontend(layout)
    _check_untouchable(layout)
    _check_buses(layout)
    if layout.device.first_serial + layout.blocks - 1 > IDENTITY_MAX:
        highest = IDENTITY_MAX - layout.blocks + 1
        raise LayoutError(
            f"expected {highest} or less, for serial numbers of 32 bits, got {layout.device.first_serial}"
            " - at `$.device.first_serial`"
        )
    if layout.recognition is not None:
        _check_recognition(layout, layout.recognition)


def _check_measurement(layout: "Layout") -> None:
    taxels, measurement = layout.taxels, layout.measurement
    powers = {
        "taxels.rows": taxels.rows,
        "taxels.columns": taxels.columns,
        "measurement.block_size": measurement.block_size,
    }
    for path, size in powers.items():
        if size & (size - 1):
            raise LayoutError(f"expected a power of two, got {size} - at `$.{path}`")
    if taxels.count % measurement.block_size:
        raise LayoutError(f"{taxels.count} taxels do not divide into blocks - at `$.measurement.block_size`")
    check_patch(taxels.rows, taxels.columns, measurement.block_size, measurement.wiring, measurement.patch)
    if not 1 <= measurement.sums <= taxels.count:
        raise LayoutError(f"expected 1 to {taxels.count} sums, got {measurement.sums} - at `$.measurement.sums`")
    if measurement.rows is not None:
        _check_rows(layout, measurement.rows)
    elif measurement.selection == "balanced" and measurement.sums > layout.blocks and measurement.sums % layout.blocks:
        wanted = f"balanced needs fewer sums than the {layout.blocks} blocks, or a multiple of them"
        raise LayoutError(f"{wanted}, got {measurement.sums} - at `$.measurement.sums`")


def _check_rows(layout: "Layout", rows: Sequence[tuple[int, int]]) -> None:
    measurement = layout.measurement
    if measurement.sums != len(rows):
        limit = f"expected {len(rows)}, one sum for each of `measurement.rows`, or no `sums`"
        raise LayoutError(f"{limit}, got {measurement.sums} - at `$.measurement.sums`")
    if measurement.selection != "balanced":
        raise LayoutError("named rows are not drawn: leave `selection` or `rows` out - at `$.measurement.selection`")
    try:
        of_rows(np.arange(layout.taxels.count), measurement.block_size, rows)
    except InputError as error:
        raise LayoutError(f"{error} - at `$.measurement.rows`") from error


def _check_frontend(layout: "Layout") -> None:
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


def _check_untouchable(layout: "Layout") -> None:
    taxels, count = layout.taxels.untouchable or (), layout.taxels.count
    outside = [taxel for taxel in taxels if not 0 <= taxel < count]
    twice = [taxel for place, taxel in enumerate(taxels) if taxel in taxels[:place]]
    if outside or twice or len(taxels) == count:
        wrong = f"{outside[0]}" if outside else f"{twice[0]} twice" if twice else "all taxels"
        limit = f"expected some of the taxels 0 to {count - 1}, each once and not all"
        raise LayoutError(f"{limit}, got {wrong} - at `$.taxels.untouchable`")


def _check_recognition(layout: "Layout", state: "Recognition") -> None:
    if not layout.is_stock:
        raise LayoutError('recognition needs `sending = "synchronous"` and `identity = "window"` - at `$.recognition`')
    if layout.sampling.rate_hz is not None:
        raise LayoutError("recognition and averages of samples exclude each other - at `$.sampling.rate_hz`")
    if layout.taxels.is_analogue:
        raise LayoutError("recognition expects 'digital', got 'analogue' - at `$.taxels.frontend`")
    for index, bus in enumerate(layout.bus):
        if bus.nodes > RECOGNITION_NODES:
            limit = f"recognition expects at most {RECOGNITION_NODES} nodes"
            raise LayoutError(f"{limit}, got {bus.nodes} - at `$.bus[{index}].nodes`")
    ratio = state.rate_hz / layout.sync.rate_hz
    if ratio < 2 or abs(ratio - round(ratio)) > 1e-9:
        limit = f"expected a multiple of {layout.sync.rate_hz:g} (`sync.rate_hz`), twice that or more"
        raise LayoutError(f"{limit}, got {state.rate_hz:g} - at `$.recognition.rate_hz`")
    if (state.sums is None) == (state.rows is None):
        raise LayoutError("expected `sums` or `rows`, one of the two - at `$.recognition`")
    try:
        part = layout.recognising().phi()
    except InputError as error:
        raise LayoutError(f"{error} - at `$.recognition.{'sums' if state.rows is None else 'rows'}`") from error
    if (part.kept & ~layout.phi().kept).any():
        raise LayoutError("expected rows that the nodes send for images - at `$.recognition.rows`")


def _check_adaptive(layout: "Layout") -> None:
    """Check what adaptive sending needs: one patch of `ADAPTIVE_BLOCK` taxels on a node, its rates, identifiers."""
    measurement = layout.measurement
    wanted = {
        "taxels.frontend": (layout.taxels.frontend, "digital"),
        "measurement.wiring": (measurement.wiring, "board"),
        "measurement.block_size": (measurement.block_size, ADAPTIVE_BLOCK),
        "measurement.sums": (measurement.sums, layout.taxels.count),
        "sync.rate_hz": (layout.sync.rate_hz, layout.sends.default_rates_hz["sync"]),
        "sampling.rate_hz": (layout.sampling.rate_hz, layout.sends.default_rates_hz["sampling"]),
    }
    for path, (got, expected) in wanted.items():
        if got != expected:
            raise LayoutError(f"adaptive sending expects {expected!r}, got {got!r} - at `$.{path}`")
    for index, bus in enumerate(layout.bus):
        most = ADAPTIVE_FD_NODES if bus.fd else ADAPTIVE_NODES
        if bus.blocks_per_node != 1 or bus.nodes > most:
            limits = f"adaptive sending expects at most {most} nodes of one block"
            raise LayoutError(f"{limits}, got {bus.nodes} of {bus.blocks_per_node} - at `$.bus[{index}]`")


def _check_buses(layout: "Layout") -> None:
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
    blocks = layout.first_block(len(layout.bus))
    if blocks != layout.blocks:
        held = f"the buses' nodes hold {blocks} blocks (`nodes` x `blocks_per_node`)"
        raise LayoutError(f"{held} but the skin has {layout.blocks} - at `$.bus`")
