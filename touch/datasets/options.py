"""Options of ``skin touch dataset``, in groups."""

from dataclasses import dataclass, make_dataclass
from typing import Annotated, Final, TypeVar

from cyclopts import Group, Parameter

from skin.defects import KINDS, Defects, Stage
from skin.taxel import FORCE_MAX_N, NOISE_N, TaxelModel
from touch.classification_poses import PERTURBATIONS
from touch.coarse_arrays import ARRAYS, Kind

EVERY_ARRAY: Final = ",".join(map(str, ARRAYS))
#: Kinds of defects that data sets have: those of taxels that show in a touch of seconds.
DEFECTS: Final = {
    name: kind for name, kind in KINDS.items() if kind.stage is not Stage.MEMORY and not kind.stage.is_of_sums
}


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


T = TypeVar("T")


def _with_defects(options: type[T]) -> type[T]:
    """Return the class with an option for each kind of defect that data sets have."""
    added = [(name, Annotated[float | None, Parameter(help=kind.help)], None) for name, kind in DEFECTS.items()]
    made: type[T] = make_dataclass(options.__name__, added, bases=(options,), frozen=True)
    made.__module__, made.__doc__ = options.__module__, options.__doc__
    return made


@Parameter(name="*", group=Group("Taxels, each defect off unless given"))
@_with_defects
@dataclass(frozen=True)
class TaxelOptions:
    """Model of the sensor.

    Attributes
    ----------
    noise_n
        Standard deviation of the noise, newtons.
    force_max_n
        End of a taxel's range, newtons.
    """

    noise_n: float = NOISE_N
    force_max_n: float = FORCE_MAX_N

    def model(self, seed: int) -> TaxelModel:
        """Return the model of the taxels; `seed` selects the defective taxels."""
        amounts = {kind: getattr(self, kind) for kind in DEFECTS}
        return TaxelModel(self.noise_n, self.force_max_n, Defects.of(amounts, seed))
