"""Cycles of the default skin, fewer in a second, whose taxels have offsets, for the tests of this folder."""

from collections.abc import Callable, Sequence
from typing import Generic, Protocol, TypeVar

import msgspec
import numpy as np
import numpy.typing as npt

from calibration.offline import measurement_of
from canskin.messages import Measurement
from skin.layout import Layout, Sync, load_layout

LAYOUT = msgspec.structs.replace(load_layout(), sync=Sync(rate_hz=40.0))
PHI = LAYOUT.phi()
ROWS, COLUMNS = LAYOUT.taxels.rows, LAYOUT.taxels.columns
NEWTON_PER_COUNT = LAYOUT.taxels.newton_per_count
#: Noise of one averaged taxel, newtons.
NOISE_N = 0.05e-3
END_CODE = 16000
Force = Callable[[float], npt.NDArray[np.floating]]


def offsets_n(seed: int = 0) -> npt.NDArray[np.float64]:
    """Offsets of 0 to 13 % of the range."""
    taxels = LAYOUT.taxels
    return np.random.default_rng(seed).uniform(0, 0.13 * taxels.force_max_n, taxels.count)


def pressed(row: int, column: int, size: int, force_n: float) -> npt.NDArray[np.float64]:
    """A square of taxels under equal force."""
    force = np.zeros((ROWS, COLUMNS))
    force[row : row + size, column : column + size] = force_n
    return force.ravel()


class Calibrates(Protocol):
    """A calibrator, or a gateway's."""

    def apply(self, measurement: Measurement) -> Measurement: ...
    def take(self, measurement: Measurement) -> None: ...
    def work(self) -> None: ...


Calibrating = TypeVar("Calibrating", bound=Calibrates)


class Skin(Generic[Calibrating]):
    """A skin whose cycles go through a calibrator, one after the other."""

    def __init__(
        self, calibrator: Calibrating, *, layout: Layout = LAYOUT, seed: int = 0, stuck: int | None = None
    ) -> None:
        self._stuck = stuck
        self.calibrator, self.layout = calibrator, layout
        self.time_s, self._cycle = 0.0, 0
        self._phi = layout.phi()
        self._random = np.random.default_rng(seed)

    def skip(self, seconds: float) -> None:
        """Let time pass without cycles."""
        self.time_s += seconds
        self._cycle += round(seconds / self.layout.sync.period_s)

    def run(
        self,
        seconds: float,
        force: Force,
        *,
        valid: npt.NDArray[np.bool_] | None = None,
        saturated: Sequence[int] = (),
    ) -> Measurement:
        """Let the skin feel ``force(time_s)``, newtons, offsets included; return the last measurement.

        The sums `saturated` have an end code.
        """
        usable = np.ones(self._phi.shape[0], np.uint8)
        usable[list(saturated)] = 0
        valid = np.ones(self.layout.blocks, np.bool_) if valid is None else valid
        for _ in range(round(seconds / self.layout.sync.period_s)):
            self.time_s += self.layout.sync.period_s
            felt_n = force(self.time_s) + self._random.normal(0, NOISE_N, self.layout.taxels.count)
            counts = np.rint(self._phi.forward(felt_n) / NEWTON_PER_COUNT).astype("<i4")
            if self._stuck is not None:
                counts[self._stuck] = 1234
            counts[list(saturated)] = END_CODE
            counts[~self._phi.sums_of_blocks(valid)] = 0
            came = measurement_of(self.layout, self._phi, self._cycle, counts, valid)
            if saturated:
                came = msgspec.structs.replace(came, usable=usable.tobytes())
            made = self.calibrator.apply(came)
            self._cycle += 1
            self.calibrator.take(came)
            self.calibrator.work()
        return made


def error_n(measurement: Measurement, force: npt.NDArray[np.floating]) -> float:
    """Return the root mean square error of the corrected sums, newtons, for the forces without offsets."""
    sums = np.frombuffer(measurement.sums, "<i4") - np.frombuffer(measurement.offsets, "<i4")
    return float(np.std(sums * NEWTON_PER_COUNT - PHI.forward(force)))
