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
    """Motion of the objects.

    Attributes
    ----------
    speed
        Speed / paper's speed.
    steps
        Steps per object; default: the whole trajectory.
    """

    speed: int = 1
    steps: int | None = None


@Parameter(name="*", group=Group("Classification"))
@dataclass(frozen=True)
class ClassificationOptions:
    """Arrays and perturbations.

    Attributes
    ----------
    arrays
        Comma-separated numbers of taxels along a side.
    kind
        Type of the taxels of a coarse array: ``averaged``, the mean of the fine taxels in a cell; ``large``, one sphere
        as large as the cell; ``sparse``, one sphere of 2 mm in the middle of the cell.
    perturbations
        Number of the paper's 360 offsets.
    """

    arrays: str = EVERY_ARRAY
    kind: Kind = "averaged"
    perturbations: int = PERTURBATIONS


@Parameter(name="*", group=Group("Taxels, each defect off unless given"))
@dataclass(frozen=True)
class TaxelOptions:
    """Model of the sensor; the defects are those of `skin.defects.KINDS`, but for creep, which takes minutes.

    Attributes
    ----------
    noise_n
        Standard deviation of the noise, newtons.
    force_max_n
        End of a taxel's range, newtons.
    damper
        Damping beside each spring, N s/m.
    cross_talk
        Fraction of each neighbour's force that a taxel reads in addition.
    gain_spread
        Standard deviation of the taxels' gains around 1.
    offset
        Largest offset of a taxel / range.
    drift
        Standard deviation of the drift of the zero point, N/s.
    noisy
        Fraction of the taxels whose noise has a standard deviation of a quarter of the range.
    stuck
        Fraction of the taxels that always read one value.
    saturated
        Fraction of the taxels that always read the end of the range.
    dead
        Fraction of the taxels that always read 0.
    """

    noise_n: float = NOISE_N
    force_max_n: float = FORCE_MAX_N
    damper: float | None = None
    cross_talk: float | None = None
    gain_spread: float | None = None
    offset: float | None = None
    drift: float | None = None
    noisy: float | None = None
    stuck: float | None = None
    saturated: float | None = None
    dead: float | None = None

    def model(self, seed: int) -> TaxelModel:
        """Return the model of the taxels; `seed` selects the defective taxels.

        Raises
        ------
        InputError
            If a number cannot be used.
        """
        amounts = {kind: amount for kind in KINDS if (amount := getattr(self, kind, None)) is not None}
        return TaxelModel(self.noise_n, self.force_max_n, **make_defects(amounts, seed))
