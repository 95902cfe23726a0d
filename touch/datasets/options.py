"""Options of ``skin dataset``, in groups."""

from dataclasses import dataclass
from typing import Final

from cyclopts import Group, Parameter

from skin.defects import KINDS, make_defects
from skin.taxel import FORCE_MAX_N, NOISE_N, TaxelModel
from touch.classification_poses import PERTURBATIONS
from touch.coarse_arrays import ARRAYS, Kind

EVERY_ARRAY: Final = ",".join(map(str, ARRAYS))


@Parameter(name="*", group=Group("Acquisition"))
@dataclass(frozen=True)
class AcquisitionOptions:
    """How objects move over the skin.

    Attributes
    ----------
    speed
        Times the paper's speed.
    steps
        Steps per object; default: the whole trajectory.
    """

    speed: int = 1
    steps: int | None = None


@Parameter(name="*", group=Group("Classification"))
@dataclass(frozen=True)
class ClassificationOptions:
    """What is touched with.

    Attributes
    ----------
    arrays
        Comma-separated numbers of taxels along a side.
    kind
        What a taxel of a coarse array is: the mean of a cell of fine ones, one sphere as large as the cell, or one of
        2 mm in its middle.
    perturbations
        How many of the paper's 360 offsets.
    """

    arrays: str = EVERY_ARRAY
    kind: Kind = "averaged"
    perturbations: int = PERTURBATIONS


@Parameter(name="*", group=Group("Taxels, each defect off unless given"))
@dataclass(frozen=True)
class TaxelOptions:
    """What makes the sensor signal of the true force; the defects are those of `skin.defects.KINDS`.

    Attributes
    ----------
    noise_n
        Standard deviation of the noise, newtons.
    force_max_n
        End of a taxel's range, newtons.
    damper
        Damping beside each spring, N s/m.
    cross_talk
        Part of each neighbour's force that a taxel reads.
    gain_spread
        Standard deviation of the taxels' gains around 1.
    drift
        Standard deviation of the taxels' drift of zero, N/s.
    noisy
        Part of the taxels whose noise is a quarter of the range.
    stuck
        Part of the taxels that always read one value.
    saturated
        Part of the taxels that always read the end of the range.
    dead
        Part of the taxels that always read 0.
    """

    noise_n: float = NOISE_N
    force_max_n: float = FORCE_MAX_N
    damper: float | None = None
    cross_talk: float | None = None
    gain_spread: float | None = None
    drift: float | None = None
    noisy: float | None = None
    stuck: float | None = None
    saturated: float | None = None
    dead: float | None = None

    def model(self, seed: int) -> TaxelModel:
        """Return the taxels' model; `seed` says which taxels a defect meets.

        Raises
        ------
        InputError
            If a number cannot be used.
        """
        amounts = {kind: amount for kind in KINDS if (amount := getattr(self, kind)) is not None}
        return TaxelModel(self.noise_n, self.force_max_n, **make_defects(amounts, seed))
