"""Options of ``skin touch dataset``, in groups."""

from dataclasses import dataclass, field
from typing import Final

from cyclopts import Group, Parameter

from canskin.errors import InputError
from skin.defects import KINDS, Stage, parse_defects
from skin.layout import load_layout
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
        as large as the cell.
    perturbations
        Number of the paper's 360 offsets.
    """

    arrays: str = EVERY_ARRAY
    kind: Kind = "averaged"
    perturbations: int = PERTURBATIONS


@Parameter(name="*", group=Group("Taxels"))
@dataclass(frozen=True)
class TaxelOptions:
    """Model of the sensor.

    Attributes
    ----------
    noise_n
        Standard deviation of the noise, newtons.
    force_max_n
        End of a taxel's range, newtons.
    defect
        Defects of the taxels, each KIND or KIND=AMOUNT, see ``skin demo --help``; without creep, which takes minutes.
    """

    noise_n: float = NOISE_N
    force_max_n: float = FORCE_MAX_N
    defect: list[str] = field(default_factory=list)

    def model(self, seed: int) -> TaxelModel:
        """Return the model of the taxels; `seed` selects the defective taxels."""
        defects = parse_defects(self.defect, (), seed, load_layout())
        if unshown := [each.kind for each in defects.of_kinds if each.kind not in DEFECTS]:
            raise InputError(f"--defect {', '.join(unshown)}: a touch of seconds does not show it, leave it out")
        return TaxelModel(self.noise_n, self.force_max_n, defects)
