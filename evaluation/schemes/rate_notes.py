"""What a reader must know about rate against quality, and what is best where, written from what was measured."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Final

from evaluation.findings import Options, Row
from evaluation.schemes.rate_points import BUDGET, ROWS, SUM_BITS, WIRES
from evaluation.schemes.scenes import SHAKING, shaking_speed_ratio
from evaluation.schemes.touches import Touch

#: How a kind of touches is called in a sentence.
KINDS: Final = {"slides": "the slides", "shaking": "the shaking boxes", "recordings": "the recordings"}


def notes(
    rows: list[Row], recommended: Sequence[Row], touches: Mapping[str, list[Touch]], options: Options
) -> list[str]:
    """Return what every point was given, what was looked at, what is left out and what is best.

    Parameters
    ----------
    rows : list of dict
        Rows of `evaluation.schemes.rates`, all points that were measured.
    recommended : sequence of dict
        Those that are best on the slides, one for each kind of wires.
    touches : mapping
        What the points were measured on, by kind.
    options : Options
        What was asked.
    """
    return [
        *_given(touches),
        *_looked_at(rows),
        *_recordings(options),
        *(_recommended(row) for row in recommended),
        *_best_elsewhere(rows),
        *_written(options),
    ]


def _given(touches: Mapping[str, list[Touch]]) -> Iterator[str]:
    yield (
        f"Every point is the highest rate at which frames with the most stuff bits use at most {BUDGET:.0%} of each "
        "bus and the window (1007h) holds, with as many blocks per node as make that highest, in offset binary."
    )
    slides = touches["slides"]
    yield (
        "The last image is held: at every millisecond it is compared with the truth of that millisecond. Slides, "
        f"{slides[0].ticks} ms at the paper's speed: {', '.join(touch.words for touch in slides)}."
    )
    if any(touch.name == SHAKING for touch in touches.get("shaking", ())):
        yield f"'{SHAKING}' are pressed up to {shaking_speed_ratio():.0f} times as fast as the paper's objects."


def _looked_at(rows: list[Row]) -> Iterator[str]:
    """Say what was measured, and which points of it cannot be laid out."""
    heights, widths = (sorted({row[key] for row in rows}) for key in ("rows_of_32", "bits"))
    if len(heights) * len(widths) < len(ROWS) * len(SUM_BITS):
        yield f"A quick look: {_listed(heights)} rows of 32 and {_listed(widths)} bits alone."
    laid_out = {(row["wires"], row["rows_of_32"], row["bits"]) for row in rows}
    for wires in WIRES:
        missing = [
            f"{rows_of_32} rows of {bits} bits"
            for rows_of_32 in heights
            for bits in widths
            if (wires, rows_of_32, bits) not in laid_out
        ]
        if missing:
            yield (
                f"{wires}: {', '.join(missing)} need more node-IDs or identifiers than CANopen has, and are left out."
            )


def _recordings(options: Options) -> Iterator[str]:
    if options.recordings is None:
        yield "Recorded touches are left out: give --recordings FOLDER."
    else:
        yield "A recording's own values count as the truth, its noise included: what averages it away is marked down."


def _recommended(row: Row) -> str:
    return (
        f"Recommended, best on the slides. {row['wires']}: {_point(row)}, {row['psnr_slides_db']:.1f} dB on the "
        f"slides, buses {row['load']:.0%} full, {row['load_worst']:.0%} at worst."
    )


def _best_elsewhere(rows: list[Row]) -> Iterator[str]:
    """Say which points are best on other touches than the slides."""
    for kind in KINDS:
        best = [row for row in rows if kind in row["best_for"]]
        if kind != "slides" and best:
            each = (f"{row['wires']}, {_point(row)}, {row[f'psnr_{kind}_db']:.1f} dB" for row in best)
            yield f"Best on {KINDS[kind]}: {'; '.join(each)}."


def _point(row: Row) -> str:
    return f"{row['sums']} sums of {row['bits']} bits at {row['rate_hz']:g} Hz"


def _written(options: Options) -> Iterator[str]:
    yield (
        "Give --out FOLDER to have the recommended layouts written, for `skin plan`."
        if options.out is None
        else "The recommended layouts are in the folder of this report, a TOML file for each: `skin plan FILE`."
    )


def _listed(numbers: Sequence[int]) -> str:
    return " and ".join(map(str, numbers))
