"""How many cells of a table come within a tolerance of the paper's, and which do not."""

from collections.abc import Callable, Sequence

from evaluation.findings import Row


def within(rows: Sequence[Row], tolerance: float, *, what: str, unit: str, least_share: float) -> str:
    """Return one line on the rows that have a number of the paper.

    Parameters
    ----------
    rows : sequence of dict
        With a ``difference``.
    tolerance : float
        Largest difference that counts as equal, in `unit`.
    what, unit : str
        Name of the cells, and of what the difference is in.
    least_share : float
        The share that is aimed at, 0 to 1.
    """
    differences = [abs(row["difference"]) for row in rows if row["difference"] is not None]
    if not differences:
        return f"{what}: no cell to compare."
    close = sum(each <= tolerance + 1e-9 for each in differences)
    verdict = "reached" if close >= least_share * len(differences) else "not reached"
    return (
        f"{what}: {close} of {len(differences)} cells within {tolerance:g} {unit} of the paper's "
        f"(aim {least_share:.0%}: {verdict}); the largest difference is {max(differences):.2f} {unit}."
    )


def outside(rows: Sequence[Row], tolerance: float, *, unit: str, name: Callable[[Row], str]) -> str | None:
    """Return one line that lists the rows beyond `tolerance`, or None where there are none."""
    far = [row for row in rows if row["difference"] is not None and abs(row["difference"]) > tolerance + 1e-9]
    if not far:
        return None
    return f"Beyond {tolerance:g} {unit}: " + "; ".join(f"{name(row)} {row['difference']:+.2f}" for row in far) + "."
