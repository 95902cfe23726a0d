"""Which of several boards is touched, by the counts (2012h) or sums that they tell while they are PRE-OPERATIONAL."""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from skin.surface import Floats, Indices

#: Least change of the counts of a board that is touched, root mean square: in standard deviations of their noise, as
#: part of the range of a taxel, and in largest rounding errors of sums. The largest of the three counts.
LEAST_DEVIATIONS: Final = 8.0
LEAST_OF_RANGE: Final = 0.02
LEAST_ROUNDINGS: Final = 4.0
#: Of several boards that change, those are touched whose change is at least this part of the largest.
PART_OF_LARGEST: Final = 0.5
#: Part of the difference by which the counts without touch follow in a round: zeros drift.
LEARNING_GAIN: Final = 0.05
#: Most columns and rows of a map.
MOST_CELLS: Final = (60, 20)


class TouchSensing:
    """Compares the counts of boards with those without touch.

    Parameters
    ----------
    rest : sequence of mapping of int to array
        Rounds without touch: counts of taxels or of sums of each board, by node-ID. A board has to be in all of them.
    count_max : int
        Largest ADC count of a taxel.
    rounding_counts : int
        Largest rounding error of a sum.
    """

    def __init__(self, rest: Sequence[Mapping[int, Floats]], count_max: int, rounding_counts: int) -> None:
        boards = set.intersection(*(set(each) for each in rest))
        told = {node_id: np.array([each[node_id] for each in rest], np.float64) for node_id in boards}
        self._mean = {node_id: sums.mean(axis=0) for node_id, sums in told.items()}
        least = max(LEAST_OF_RANGE * count_max, LEAST_ROUNDINGS * rounding_counts)
        self._least = {
            node_id: max(least, LEAST_DEVIATIONS * float(np.sqrt(sums.var(axis=0).mean())))
            for node_id, sums in told.items()
        }

    def touched(self, told: Mapping[int, Floats]) -> tuple[int, ...]:
        """Return the node-IDs of the boards that are touched in a round; learn the others' counts without touch."""
        changes = {node_id: told[node_id] - mean for node_id, mean in self._mean.items() if node_id in told}
        sizes = {node_id: float(np.sqrt((each**2).mean())) for node_id, each in changes.items()}
        for node_id, size in sizes.items():
            if size < self._least[node_id] / 2:
                self._mean[node_id] += LEARNING_GAIN * changes[node_id]
        largest = max(sizes.values(), default=0.0)
        return tuple(
            sorted(
                each for each, size in sizes.items() if size >= self._least[each] and size >= PART_OF_LARGEST * largest
            )
        )


def map_of(positions_m: Floats, taxels: Indices) -> list[str]:
    """Return a map of a skin as lines of text: ``#`` for `taxels`, ``.`` for others; the two longest axes are shown.

    Columns are those of x of a flat skin, rows those of y, downwards.
    """
    spans_m = np.ptp(positions_m, axis=0)
    axes = np.sort(np.argsort(-spans_m, kind="stable")[:2])
    spans_m, places_m = spans_m[axes], positions_m[:, axes] - positions_m[:, axes].min(axis=0)
    cells = np.minimum(np.array(MOST_CELLS), np.maximum(1, [len(np.unique(each)) for each in np.round(places_m.T, 6)]))
    at = np.round(places_m / np.where(spans_m > 0, spans_m, 1.0) * (cells - 1)).astype(np.intp)
    shown = np.full((cells[1], cells[0]), " ")
    shown[at[:, 1], at[:, 0]] = "."
    shown[at[taxels, 1], at[taxels, 0]] = "#"
    return ["".join(row) for row in shown]
