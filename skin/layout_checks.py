"""The checks of keys that depend on each other."""

import math
from collections import Counter
from collections.abc import Sequence
from typing import Final

import numpy as np

from canskin.errors import InputError, LayoutError
from skin.chains import check_chains
from skin.foreign import check_foreign
from skin.layout_keys import (
    GAP,
    IDENTITY_MAX,
    NODES_MAX,
    OTHER_HARDWARE,
    PLACES_MAX,
    SIDE_MAX,
    TAXEL,
    TAXELS_MIN,
    Bus,
    Layout,
    PhiParameters,
    Steps,
    Taxels,
    require_boards,
)
from skin.matrix import KEY
from skin.phi import of_rows, sbhe
from skin.regions import regions_of
from skin.sync_counter import SYNC_OVERFLOW
from skin.ways_of_sending import STEPPED_SIZES

#: Slots fill the SYNC period up to this ratio: a part of a period may have no decimal fraction.
_SLOT_ERROR: Final = 1e-6
#: Begins the errors of layouts whose boards send steps.
_OF_STEPS: Final = '`sending = "steps"` expects'
#: Fewest bits of a converter of sums: its two end codes count as saturated.
ANALOGUE_BITS: Final = 4


def check(layout: Layout, *, has_steps: bool = False) -> None:
    """Check keys that depend on each other; `has_steps` tells that a file has the table of steps."""
    _check_shape(layout.taxels)
    if layout.taxels.there < TAXELS_MIN:
        raise LayoutError(f"expected {TAXELS_MIN} taxels or more, got {layout.taxels.there} - at `$.taxels`")
    _check_positions(layout.taxels)
    _check_taxels(layout, "untouchable", layout.taxels.untouchable)
    _check_taxels(layout, "masked", layout.taxels.masked)
    _check_regions(layout)
    if (layout.measurement.ensemble == "matrix") != (layout.measurement.matrix is not None):
        wanted = f"`matrix` and ensemble = 'matrix' belong together, got '{layout.measurement.ensemble}'"
        raise LayoutError(f"{wanted} - at `$.measurement.ensemble`")
    if layout.measurement.matrix is not None:
        _check_matrix(layout)
        if layout.taxels.masked:
            require_boards(layout)
        return
    _check_measurement(layout)
    if not layout.sends.in_cycles:
        _check_stepped(layout)
    elif has_steps or layout.steps != Steps():
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
    if layout.taxels.masked:
        _check_masked(layout)


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
            for key in ("block_size", "rows", "selection", "seed", "wiring", "chains")
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


def _check_positions(taxels: Taxels) -> None:
    count = len(taxels.positions or ())
    if taxels.positions is None:
        if taxels.columns > SIDE_MAX:
            raise LayoutError(f"expected {SIDE_MAX} or less, got {taxels.columns} - at `$.taxels.columns`")
        return
    if (taxels.rows, taxels.columns) != (1, count) or taxels.shape is not None:
        raise LayoutError(
            "taxels at positions are no grid: leave rows, columns and shape out - at `$.taxels.positions`"
        )
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


def _check_taxels(layout: Layout, key: str, given: tuple[int, ...] | None) -> None:
    taxels, count = given or (), layout.taxels.count
    outside = [taxel for taxel in taxels if not 0 <= taxel < count]
    twice = [taxel for taxel, times in Counter(taxels).items() if times > 1]
    if outside or twice or not set(range(count)) - set(taxels) - set(layout.taxels.gaps.tolist()):
        wrong = f"{outside[0]}" if outside else f"{twice[0]} twice" if twice else "all taxels"
        limit = f"expected some of the taxels 0 to {count - 1}, each once and not all"
        raise LayoutError(f"{limit}, got {wrong} - at `$.taxels.{key}`")


def _check_masked(layout: Layout) -> None:
    """Check that each block has more sums than masked taxels: else its sums tell nothing."""
    phi, is_masked = layout.phi(), layout.taxels.is_masked
    masked = np.bincount(phi.block_of_taxel[is_masked & phi.is_wired], minlength=phi.blocks)
    sums = np.diff(phi.starts)
    for block in np.flatnonzero((masked > 0) & phi.has_sums & (sums <= masked)).tolist():
        raise LayoutError(
            f"block {block}: expected fewer than {sums[block]} masked taxels, its number of sums, got {masked[block]}"
            " - at `$.taxels.masked`"
        )


def _check_regions(layout: Layout) -> None:
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
    if others := set(bus.optional or ()) - set(bus.ids):
        raise LayoutError(f"expected node-IDs of the bus, got {min(others)} - at `{path}.optional`")
    if bus.ids[-1] > NODES_MAX:
        limit = f"expected {NODES_MAX + 1 - bus.nodes} or less, for {bus.nodes} node-IDs up to {NODES_MAX}"
        raise LayoutError(f"{limit}, got {bus.first_node_id} - at `{path}.first_node_id`")
