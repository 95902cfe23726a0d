"""Options of ``skin dataset``, in groups."""

from dataclasses import dataclass
from typing import Final

from cyclopts import Group, Parameter

from touch.arrays import ARRAYS, Kind
from touch.contact import FORCE_MAX_N
from touch.effects import CrossTalk, Damper, Dead, Drift, GainSpread, Stuck
from touch.electronics import NOISE_N, Electronics
from touch.perturbations import PERTURBATIONS

EVERY_ARRAY: Final = ",".join(map(str, ARRAYS))


@Parameter(name="*", group=Group("Acquisition"))
@dataclass(frozen=True)
class Slides:
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
class Touches:
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


@Parameter(name="*", group=Group("Taxels, each effect off unless given"))
@dataclass(frozen=True)
class Taxels:
    """What makes the sensor signal of the true force.

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
    stuck
        Part of the taxels that always read one value.
    dead
        Part of the taxels that always read 0.
    """

    noise_n: float = NOISE_N
    force_max_n: float = FORCE_MAX_N
    damper: float | None = None
    cross_talk: float | None = None
    gain_spread: float | None = None
    drift: float | None = None
    stuck: float | None = None
    dead: float | None = None

    def electronics(self, seed: int) -> Electronics:
        """Return them as `touch.electronics.Electronics`; `seed` says which taxels an effect meets.

        Raises
        ------
        InputError
            If a number cannot be used.
        """
        return Electronics(
            self.noise_n,
            self.force_max_n,
            damper=None if self.damper is None else Damper(self.damper),
            cross_talk=None if self.cross_talk is None else CrossTalk(self.cross_talk),
            gain_spread=None if self.gain_spread is None else GainSpread(self.gain_spread, seed),
            drift=None if self.drift is None else Drift(self.drift, seed),
            stuck=None if self.stuck is None else Stuck(self.stuck, seed),
            dead=None if self.dead is None else Dead(self.dead, seed),
        )
