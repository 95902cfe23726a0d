"""What Tables II and III share: how many draws and steps are rebuilt, what is aimed at, and the columns of a cell."""

from typing import Final

import numpy as np

from evaluation.findings import Row, beside
from evaluation.paper.printed import BasisName, Matrix, Psnr

#: Draws of Φ and of the noise that are averaged, without --draws.
DRAWS: Final = 5
#: Every how many steps are rebuilt with 20 iterations. Measured once on the clamp with 1024 sums, contourlets lose
#: 0.04 dB by it.
STRIDE: Final[dict[BasisName, int]] = {"haar": 1, "contourlet": 4}
QUICK_STRIDE: Final[dict[BasisName, int]] = {"haar": 10, "contourlet": 20}
#: By kind of Φ and basis: tolerance in dB, and the share of cells it is aimed at for.
AIMS: Final[dict[tuple[Matrix, BasisName], tuple[float, float]]] = {
    ("sbhe", "haar"): (0.4, 0.9),
    ("noiselet", "haar"): (0.5, 0.8),
    ("sbhe", "contourlet"): (1.0, 0.7),
    ("noiselet", "contourlet"): (1.0, 0.7),
}


def psnr_columns(found: list[Row], printed: Psnr | None) -> Row:
    """Return the columns of one cell from its draws: the mean beside the paper's, the spread over draws, the range."""
    means = [each["mean"] for each in found]
    return beside(float(np.mean(means)), printed.mean if printed else None) | {
        "spread": round(float(np.std(means)), 2),
        "least": round(float(np.mean([each["least"] for each in found])), 1),
        "paper_least": printed.least if printed else None,
        "most": round(float(np.mean([each["most"] for each in found])), 1),
        "paper_most": printed.most if printed else None,
    }


def cell_name(row: Row) -> str:
    """Return what a row of Table II or III is called in a note."""
    return " ".join(str(row[key]) for key in ("object", "matrix", "sums", "basis", "iterations") if key in row)
