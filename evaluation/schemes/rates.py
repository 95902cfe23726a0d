"""``skin evaluate rates``: how many sums, of how many bits, how often: what the same bus time is best used for."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import numpy as np

from bandwidth.alternatives import planned
from bandwidth.traffic import Disturbance
from dbc.contract import contract
from evaluation.cells import measure_cells
from evaluation.findings import Findings, Options, Row
from evaluation.schemes.contenders import Touch, measured_row
from evaluation.schemes.rate_pictures import pictures
from evaluation.schemes.rate_points import BUDGET, WIRES, Point, points
from evaluation.schemes.scenes import SLIDES, recordings_in
from evaluation.schemes.sums import run_sums
from skin.errors import InputError
from skin.layout import parse_layout

#: Presses and lifts up to twenty times as fast as the paper's objects are pressed.
FAST: Final = "two boxes shaking"
TICKS: Final = 2000
#: PSNR columns, and the touches they are the mean of; recordings come on top.
_KINDS: Final = ("slides", "shaking", "recordings")


def evaluate(options: Options) -> Findings:
    """Measure every point on every touch, and choose one for each kind of wires.

    Parameters
    ----------
    options : Options
        `recordings` adds the recorded touches, `out` gets the chosen layouts, `quick` looks at few points of one touch.
    """
    looked_at = [point for point in points() if not options.quick or (point.rows in {4, 8} and point.bits != 12)]
    touches = _touches(options)
    cells = [
        {"text": point.text, "touch": asdict(touch)}
        for point in looked_at
        for mine in touches.values()
        for touch in mine
    ]
    results = iter(measure_cells(measure_point, cells, options, "rates"))
    rows = []
    for point in looked_at:
        found = {kind: [next(results) for _ in mine] for kind, mine in touches.items()}
        rows.append(_row(point, found))
    chosen = {}
    for wires in WIRES:
        for kind in reversed([kind for kind, mine in touches.items() if mine]):
            index = chosen[wires] = _best(rows, wires, kind)
            rows[index]["best_for"] = " ".join([kind, *str(rows[index]["best_for"]).split()])
    for wires, index in chosen.items():
        if options.out is not None:
            _write(options.out / f"{wires.replace(' ', '-')}.toml", looked_at[index].text)
    return Findings(
        "Rate against quality: what the same bus time is best used for",
        rows,
        _notes(rows, chosen, options),
        pictures(rows),
    )


def measure_point(text: str, touch: dict[str, Any]) -> Row:
    """Return the figures of a layout, TOML, on one touch."""
    shown = Touch(**touch)
    what, made = shown.load(), contract(parse_layout(text.encode(), "point"))
    run = run_sums(made, what.counts)
    return measured_row(what, run.sent, run.latency_ns, run.images(made))


def _touches(options: Options) -> dict[str, list[Touch]]:
    if options.quick:
        return {"slides": [Touch("golf-ball", ticks=500, seed=options.seed)]}
    meshes = str(options.meshes) if options.meshes else None
    return {
        "slides": [Touch(name, ticks=TICKS, meshes=meshes, seed=options.seed) for name in SLIDES],
        "shaking": [Touch(FAST, ticks=TICKS // 2, meshes=meshes, seed=options.seed)],
        "recordings": [Touch(path, ticks=TICKS, seed=options.seed) for path in recordings_in(options.recordings)],
    }


def _row(point: Point, found: dict[str, list[Row]]) -> Row:
    """Return one row of the table: the layout, its plan, and the means over the touches."""
    plans = planned(point.layout, Disturbance())
    bus = point.layout.bus[0]
    row: Row = {
        "wires": point.wires,
        "rows_of_32": point.rows,
        "sums": point.layout.measurement.sums,
        "bits": point.bits,
        "rate_hz": point.layout.sync.rate_hz,
        "nodes": f"{len(point.layout.bus)} x {bus.nodes} of {bus.blocks_per_node}",
        "load_worst": round(max(plan.load_worst for plan in plans), 3),
        "load": round(float(np.mean([each["load"] for each in found["slides"]])), 3),
    }
    for kind in _KINDS:
        row[f"psnr_{kind}_db"] = _mean(found.get(kind, ()), "psnr_mean_db", 2)
    row["touched_error_mn"] = _mean(found["slides"], "touched_error_mn", 3)
    row["touched_shaking_mn"] = _mean(found.get("shaking", ()), "touched_error_mn", 3)
    row["latency_worst_ms"] = round(max(each["latency_worst_ms"] for each in found["slides"]), 2)
    return row | {"best_for": ""}


def _mean(found: Sequence[Row], key: str, digits: int) -> float | None:
    return round(float(np.mean([each[key] for each in found])), digits) if found else None


def _best(rows: list[Row], wires: str, kind: str) -> int:
    """Return the row of `wires` with the best mean PSNR on a kind of touches."""
    mine = [index for index, row in enumerate(rows) if row["wires"] == wires]
    return max(mine, key=lambda index: float(rows[index][f"psnr_{kind}_db"]))


def _write(path: Path, text: str) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"'{path}' cannot be written: {error}; give another --out") from error


def _notes(rows: list[Row], chosen: dict[str, int], options: Options) -> list[str]:
    given = (
        f"Every point is the highest rate at which frames with the most stuff bits use at most {BUDGET:.0%} of each "
        "bus and the window (1007h) holds, with as many blocks per node as make that highest, in offset binary."
    )
    judged = (
        "The last image is held: at every millisecond it is compared with the truth of that millisecond. Slides are "
        f"the paper's five at its speed; '{FAST}' press and lift up to twenty times as fast as its objects are pressed."
    )
    missing = (
        "Points of one classic bus that need more node-IDs or identifiers than CANopen has cannot be laid out and are "
        "left out. Recommended are those that are best on the slides."
    )
    recordings = (
        "Recorded touches are left out: give --recordings FOLDER."
        if options.recordings is None
        else "A recording's own values count as the truth, its noise included, and it moves little: there, more sums "
        "win whatever they cost in rate, and what averages noise away loses."
    )
    written = (
        "Give --out FOLDER to have the recommended layouts written, for `skin plan`."
        if options.out is None
        else "The recommended layouts are in the folder of this report, a TOML file for each: `skin plan FILE`."
    )
    return [given, judged, missing, recordings, *(_words(rows[index]) for index in chosen.values()), written]


def _words(row: Row) -> str:
    return (
        f"{row['wires']}: {row['rate_hz']:g} Hz, {row['sums']} sums of {row['bits']} bits, {row['psnr_slides_db']:.1f} "
        f"dB on the slides, buses {row['load']:.0%} full, {row['load_worst']:.0%} at worst."
    )
