"""``skin evaluate rates``: how many sums, of how many bits, how often: what the same bus time is best used for."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import Final

import msgspec
import numpy as np

from bandwidth.alternatives import BLOCKS_PER_NODE, planned, with_buses
from bandwidth.highest_rate import highest_rate_hz
from bandwidth.traffic import Disturbance
from canskin.errors import LayoutError
from evaluation.result import Options, Result, Row, write_text
from evaluation.result_cache import measure_cells
from evaluation.schemes.scenes import SHAKING, Touch, recordings_in
from evaluation.schemes.schemes import Sums, measure_scheme
from skin.layout import Bus, Layout, changed, layout_text, load_layout, validated

#: Part of each bus that frames with the most stuff bits may use; the default skin uses 0.87.
BUDGET: Final = 0.9
#: Rows of 32 that every block sends.
ROWS: Final = (4, 8, 16, 32)
#: The recorded touches have one image a millisecond: more cycles would see nothing new.
RATE_MAX_HZ: Final = 1000.0
_FD: Final = Bus(name="bus0", nodes=1, fd=True, data_bitrate=5_000_000)
#: How many buses of which kind.
WIRES: Final = {
    "one classic bus": (1, Bus(name="bus0", nodes=1)),
    "four classic buses": (4, Bus(name="bus0", nodes=1)),
    "one FD bus": (1, _FD),
}
#: Milliseconds of a slide and of a recording; boxes shake for half as long.
TICKS: Final = 2000
QUICK_TICKS: Final = 500
#: Widths of a sum: those of four, five and seven sums in a classic frame.
BITS: Final = (8, 11, 14)
#: Points of a quick look.
QUICK_SUMS, QUICK_BITS = (512, 1024), (8, 14)
#: PSNR columns, and the touches they are the mean of; recordings come on top.
_KINDS: Final = ("slides", "shaking", "recordings")


def evaluate(options: Options) -> Result:
    """Measure every point on every touch, and choose one for each kind of wires.

    Parameters
    ----------
    options : Options
        `recordings` adds the recorded touches, `out` gets the chosen layouts, `quick` looks at few points of one touch.
    """
    looked_at = [point for point in points() if not options.quick or _is_quick(point[1])]
    touches = _touches(options)
    rows = _measured(looked_at, touches, options)
    best = {kind: [_best(rows, wires, kind) for wires in WIRES] for kind in touches}
    for wires, place in zip(WIRES, best["slides"], strict=True):
        if options.out is not None:
            write_text(options.out / f"{wires.replace(' ', '-')}.toml", layout_text(looked_at[place][1]))
    rows = [
        row | {"best_for": " ".join(kind for kind in touches if place in best[kind])} for place, row in enumerate(rows)
    ]
    return Result("Rate against quality: what the same bus time is best used for", rows)


def _measured(looked_at: list[tuple[str, Layout]], touches: Mapping[str, list[Touch]], options: Options) -> list[Row]:
    """Return a row for every point."""
    every = [touch for mine in touches.values() for touch in mine]
    cells = [{"layout": layout, "touch": touch} for _, layout in looked_at for touch in every]
    results = iter(measure_cells(measure_point, cells, options, "rates"))
    return [
        _row(wires, layout, {kind: [next(results) for _ in mine] for kind, mine in touches.items()})
        for wires, layout in looked_at
    ]


def _is_quick(layout: Layout) -> bool:
    return layout.measurement.sums in QUICK_SUMS and layout.encoding.sum_bits in QUICK_BITS


def measure_point(layout: Layout, touch: Touch) -> Row:
    """Return the figures of a layout on one touch."""
    return measure_scheme(Sums(layout), touch)


def _touches(options: Options) -> dict[str, list[Touch]]:
    """Return the touches of each kind that is looked at."""
    if options.quick:
        return {"slides": [Touch(options.objects[0], ticks=QUICK_TICKS, seed=options.seed)]}
    meshes = options.shared["meshes"]
    found = {
        "slides": [Touch(name, ticks=TICKS, meshes=meshes, seed=options.seed) for name in options.objects],
        "shaking": [Touch(SHAKING, ticks=TICKS // 2, meshes=meshes, seed=options.seed)],
        "recordings": [Touch(path, ticks=TICKS, seed=options.seed) for path in recordings_in(options.recordings)],
    }
    return {kind: mine for kind, mine in found.items() if mine}


def _row(wires: str, layout: Layout, found: dict[str, list[Row]]) -> Row:
    """Return one row of the table: the layout, its plan, and the means over the touches."""
    plans = planned(layout, Disturbance())
    bus = layout.bus[0]
    row: Row = {
        "wires": wires,
        "rows_of_32": layout.measurement.sums // layout.blocks,
        "sums": layout.measurement.sums,
        "bits": layout.encoding.sum_bits,
        "rate_hz": layout.sync.rate_hz,
        "nodes": f"{len(layout.bus)} x {bus.nodes} of {bus.blocks_per_node}",
        "load_worst": round(max(plan.load_worst for plan in plans), 3),
        "load": round(float(np.mean([each["load"] for each in found["slides"]])), 3),
    }
    for kind in _KINDS:
        row[f"psnr_{kind}_db"] = _mean(found.get(kind, ()), "psnr_mean_db", 2)
    row["touched_error_mn"] = _mean(found["slides"], "touched_error_mn", 3)
    row["touched_shaking_mn"] = _mean(found.get("shaking", ()), "touched_error_mn", 3)
    row["latency_worst_ms"] = round(max(each["latency_worst_ms"] for each in found["slides"]), 2)
    return row


def _mean(found: Sequence[Row], key: str, digits: int) -> float | None:
    return round(float(np.mean([each[key] for each in found])), digits) if found else None


def _best(rows: list[Row], wires: str, kind: str) -> int:
    """Return the row of `wires` with the best mean PSNR on a kind of touches."""
    mine = [index for index, row in enumerate(rows) if row["wires"] == wires]
    return max(mine, key=lambda index: float(rows[index][f"psnr_{kind}_db"]))


def points() -> Iterator[tuple[str, Layout]]:
    """Yield every combination that can be laid out with its wires, with as many blocks per node as make it fastest.

    Each layout has the highest rate that keeps `BUDGET` and the window (1007h).
    """
    for wires, rows, bits in product(WIRES, ROWS, BITS):
        found = list(_layouts(wires, rows, bits))
        if found:
            yield wires, max(found, key=lambda layout: layout.sync.rate_hz)


def _layouts(wires: str, rows: int, bits: int) -> Iterator[Layout]:
    """Yield one layout for each number of blocks per node that is possible, each at its highest rate."""
    start = load_layout()
    buses, like = WIRES[wires]
    encoding = {"sum_bits": bits, "offset_binary": True}
    start = changed(start, measurement={"sums": rows * start.blocks}, encoding=encoding)
    for per_node in BLOCKS_PER_NODE:
        layout = with_buses(start, buses, msgspec.structs.replace(like, blocks_per_node=per_node))
        try:
            rate_hz = min(RATE_MAX_HZ, highest_rate_hz(layout, BUDGET))
        except LayoutError:
            continue  # more nodes than node-IDs, or more frames than identifiers
        if rate_hz > 0:
            yield validated(changed(layout, sync={"rate_hz": rate_hz}))
