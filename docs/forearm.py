"""The taxels of the example layout `forearm`: `python -m docs.forearm` writes `skin/layouts/forearm.csv` again.

23 triangles with sides of 30 mm lie in five strips along a half cone, with ten taxels each. The rows of taxels on both
sides of a seam are as far apart as the taxels of a row. The strips are numbered up and down the arm; three triangles
that follow each other share a board of 32 places, and the last board has two. The places of a board are in the order
of `skin.walsh.neighbours`, so that steps are sums of neighbours.
"""

from pathlib import Path
from typing import Final

import numpy as np

from skin.walsh import neighbours

SIDE_M: Final = 0.030
HEIGHT_M: Final = SIDE_M * 3**0.5 / 2
#: First triangle of each strip, and the one after its last.
STRIPS: Final = ((1, 5), (0, 5), (0, 5), (0, 5), (0, 4))
TAXELS_OF_BOARD: Final = 30
PLACES: Final = 32
#: Distance of the taxels of a triangle: their rows are this far from the next triangle's.
SPACING_M: Final = SIDE_M / (3 + 3**0.5)
#: Radius at the elbow, and what it loses on each metre towards the hand.
ELBOW_M: Final = 0.046
TAPER: Final = 0.10
FILE: Final = Path(__file__).parents[1] / "skin" / "layouts" / "forearm.csv"


def unrolled() -> np.ndarray:
    """Return the taxels on the unrolled cone, along the arm and around it, shape (230, 2)."""
    row = np.repeat(np.arange(4), np.arange(4, 0, -1))
    step = np.concatenate([np.arange(4 - each) for each in range(4)])
    upright = np.stack((step + row / 2 - 1.5, (row - 1) * 3**0.5 / 2), axis=1) * SPACING_M
    found = []
    for strip, ends in enumerate(STRIPS):
        for place in range(*ends)[:: -1 if strip % 2 else 1]:
            turn = -1 if (strip + place) % 2 else 1
            middle = place * SIDE_M / 2, (strip - 2) * HEIGHT_M
            found.append(middle + turn * (upright - (0.0, HEIGHT_M / 6)))
    return np.array(found).reshape(-1, 2)


def forearm() -> list[str]:
    """Return the lines of the file."""
    flat = unrolled()
    along = flat[:, 0] - flat[:, 0].min()
    radius = ELBOW_M - TAPER * along
    angle = flat[:, 1] / radius
    normals = np.stack((np.sin(angle), np.cos(angle), np.full(angle.shape, TAPER)), axis=1) / np.hypot(1.0, TAPER)
    numbers = np.column_stack((radius * np.sin(angle), radius * np.cos(angle), along, normals))
    lines = ["x_m,y_m,z_m,nx,ny,nz,board,place"]
    for first in range(0, len(flat), TAXELS_OF_BOARD):
        order = neighbours(flat[first : first + TAXELS_OF_BOARD], 1, PLACES)[0].tolist()
        for taxel in range(first, min(first + TAXELS_OF_BOARD, len(flat))):
            place = f"{first // TAXELS_OF_BOARD},{order.index(taxel - first)}"
            lines.append(",".join(f"{each:.5f}" for each in numbers[taxel]) + f",{place}")
    return lines


if __name__ == "__main__":
    FILE.write_text("\n".join(forearm()) + "\n")
