"""Notes and captions of ``skin evaluate recognition``, from the rows that were measured."""

from collections.abc import Sequence
from typing import Final

from evaluation.findings import Options, Row
from evaluation.observations.signals import TAXELS
from evaluation.recognition.methods import CYCLES, LOST_RATIO, PLAIN

CHOSEN: Final = "rows chosen"
MISSING: Final = "10 % missing"


def notes(methods: Sequence[Row], unmet: Sequence[tuple[str, float]], options: Options) -> list[str]:
    """Return what a reader must know to judge the rows.

    Parameters
    ----------
    methods : sequence of dict
        Rows of the methods.
    unmet : sequence of (str, float)
        Objects the live model never met, and the percent of their cycles called unknown.
    options : Options
    """
    objects = "meshes" if options.meshes else "the shapes that ship"
    chosen = " or ".join(str(row["sums"]) for row in methods if row["what"] == CHOSEN)
    name, percent = min(unmet, key=lambda one: one[1])
    told = [
        (
            "Percent. Every method is given the sums and the training perturbations of the plain DAGSVM it stands "
            "beside, one split for each draw of Φ; test perturbations take part in no choice. "
            f"Objects of the methods: {objects}; of the live rows: always the shapes that ship."
        ),
        (
            f"Rows chosen: of all {TAXELS} rows of the same scrambled blocks, the {chosen} that tell the training "
            "observations apart best; choosing them needs one recording of the training touches with every row."
        ),
        (
            f"Mean of {CYCLES} cycles: trained on single cycles; only what is asked about is a mean over cycles of "
            "one touch."
        ),
        (
            f"{LOST_RATIO:.0%} of the blocks missing: other blocks in every observation. Rehearsed: trained on the "
            f"whole sums and on the same with such losses. The service estimates missing raw sums. {_missing(methods)}"
        ),
        (
            "Live: the default skin and the model the service trains by itself, every cycle in which an object "
            "touches with 2 mN or more; 'runs' are touches. Of the objects never met, the one least often called "
            f"unknown: {name}, {percent:.0f} %."
        ),
    ]
    if options.quick:
        told.append("A quick look: few methods, one draw and single touches; it judges no figure.")
    return told


def caption(methods: Sequence[Row]) -> str:
    """Return the caption of the methods' plot: what gains most, and chosen sums beside more drawn ones."""
    most = max(methods, key=lambda row: float(row["gain"]))
    told = (
        "Accuracy of each method beside the plain DAGSVM on the same sums and training data; whiskers span the draws "
        f"of Φ. Most is gained by '{most['what']}' with {most['sums']} sums: {most['gain']:.1f} points."
    )
    chosen = {row["sums"]: row["ours"] for row in methods if row["what"] == CHOSEN}
    drawn = {row["sums"]: row["ours"] for row in methods if row["what"] == PLAIN}
    few, many = max(chosen), max(drawn)
    if few < many:
        told += f" {few} chosen sums are right in {chosen[few]:.1f} %, {many} drawn ones in {drawn[many]:.1f} %."
    return told


def _missing(methods: Sequence[Row]) -> str:
    best: dict[int, Row] = {}
    for row in methods:
        if row["what"].startswith(MISSING):
            best[row["sums"]] = max(best.get(row["sums"], row), row, key=lambda one: float(one["ours"]))
    losses = "; ".join(
        f"with {size} sums '{row['what'].removeprefix(MISSING + ': ')}' ({row['gain']:+.1f} points)"
        for size, row in best.items()
    )
    return f"Least is lost {losses}."
