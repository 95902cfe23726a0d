"""Cycles of the default skin, fewer in a second, and of a small one without random noise, for tests of calibration."""

from collections.abc import Callable, Sequence
from typing import Generic, Protocol, TypeVar

import msgspec
import numpy as np
import numpy.typing as npt

from calibration.calibrator import Calibrator
from calibration.drift import DriftFollower
from calibration.field import FieldFinder
from calibration.offline import measurement_of
from calibration.windows import Window
from calibration.zero import Zero
from canskin.calibration_messages import CalibrationState, ZeroSupport
from canskin.messages import Measurement
from skin.layout import Layout, Sync, load_layout
from skin.surface import grid_surface
from tests.layouts import small_layout

LAYOUT = msgspec.structs.replace(load_layout(), sync=Sync(rate_hz=40.0))
PHI = LAYOUT.phi()
ROWS, COLUMNS = LAYOUT.taxels.rows, LAYOUT.taxels.columns
NEWTON_PER_COUNT = LAYOUT.taxels.newton_per_count
#: Noise of one averaged taxel, newtons.
NOISE_N = 0.05e-3
END_CODE = 16000
Floats = npt.NDArray[np.float64]
#: A small skin whose boards average, so they undo the bias of clipping; its offsets in counts, which are like no touch.
SMALL = small_layout(32, 32, sync={"rate_hz": 40.0}, sampling={"rate_hz": 1000.0})
SMALL_PHI = SMALL.phi()
SMALL_SUMS, SMALL_COUNT_N = SMALL_PHI.shape[0], SMALL.taxels.newton_per_count
Counts = npt.NDArray[np.int32]
COUNTS: Counts = np.random.default_rng(3).integers(-50, 50, SMALL_SUMS).astype(np.int32)
Force = Callable[[float], npt.NDArray[np.floating]]


def offsets_n(seed: int = 0) -> Floats:
    """Offsets of 0 to 13 % of the range."""
    taxels = LAYOUT.taxels
    return np.random.default_rng(seed).uniform(0, 0.13 * taxels.force_max_n, taxels.count)


def still(force: npt.NDArray[np.floating]) -> Force:
    """The same force at all times."""
    return lambda _time_s: force


def pressed(row: int, column: int, size: int, force_n: float, shape: tuple[int, int] = (ROWS, COLUMNS)) -> Floats:
    """A square of taxels under equal force."""
    force = np.zeros(shape)
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

    def __init__(self, calibrator: Calibrating, *, layout: Layout = LAYOUT, seed: int = 0) -> None:
        self.calibrator, self.layout = calibrator, layout
        self.time_s, self._cycle = 0.0, 0
        self._phi = layout.phi()
        self._random = np.random.default_rng(seed)

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


def pressed_counts(row: int, column: int, width: int, counts: int) -> Counts:
    """Return the sums of a square of taxels that all read so many counts."""
    force = np.zeros((32, 32), np.int32)
    force[row : row + width, column : column + width] = counts
    return np.asarray(SMALL_PHI.forward(force.ravel()), np.int32)


class Cycles:
    """Cycles 25 ms apart, ten in a window: the sums change by 2 · `noise` counts from cycle to cycle, up and down."""

    def __init__(self, layout: Layout = SMALL, noise: int | Counts = 3, **options: object) -> None:
        self.said: list[str] = []
        self.layout, self.noise = layout, noise
        self.made = Calibrator(layout, say=self.said.append, **options)  # type: ignore[arg-type]
        self.cycle = 0
        self.missing: list[int] = []

    def measured(self, counts: Counts) -> Measurement:
        valid = np.ones(SMALL_PHI.blocks, np.bool_)
        valid[self.missing] = False
        shaken = counts + self.noise * (-1) ** self.cycle * np.where(np.arange(SMALL_SUMS) % 3, 1, -1)
        return measurement_of(self.layout, SMALL_PHI, self.cycle, shaken, valid)

    def run(self, windows: float, counts: Counts = COUNTS, drift: float | Floats = 0.0) -> Measurement:
        """Go on for so many windows, with offsets that grow by `drift` counts in each; return the last as it went."""
        for _ in range(round(10 * windows)):
            moved = np.rint(counts + drift * self.cycle / 10).astype(np.int32)
            came = self.measured(moved)
            self.cycle += 1
            applied = self.made.apply(came)
            self.made.take(came)
            self.made.work()
        return applied


def offsets_of(measurement: Measurement) -> list[int]:
    return np.frombuffer(measurement.offsets, "<i4").tolist()


def tared(**options: object) -> Cycles:
    """Return a skin with a zero: two windows to settle, and eight."""
    skin = Cycles(**options)  # type: ignore[arg-type]
    skin.run(10.1)
    assert skin.made.state is CalibrationState.FOLLOWING
    return skin


def small_patch(row: int, column: int, size: int, force_n: float) -> Floats:
    """A square of taxels of the small skin under equal force."""
    return pressed(row, column, size, force_n, (32, 32))


class FedZero:
    """A zero of the small skin that is fed with windows; at first all offsets are 0."""

    #: Standard deviation of the mean of a sum.
    NOISE_N = 9e-5

    def __init__(
        self, support: ZeroSupport = ZeroSupport.MEASURED, references: npt.NDArray[np.bool_] | bool = False
    ) -> None:
        self.finder = FieldFinder(SMALL_PHI, grid_surface(32, 32, 0.004, np.zeros(0, np.intp)))
        self.known = np.ones(SMALL_SUMS, np.bool_)
        self.windows = 0
        self._nothing = np.zeros(SMALL_SUMS)
        self._random = np.random.default_rng(0)
        follower = DriftFollower(
            SMALL_PHI.block_of_sum,
            SMALL_PHI.blocks,
            self._nothing,
            self._nothing,
            self.known,
            age=8 if support is ZeroSupport.MEASURED else 0,
            noise_n=self.NOISE_N,
            least_noise_n=1e-6,
        )
        untouchable = np.broadcast_to(references, SMALL_PHI.shape[1])
        self.zero = Zero(
            SMALL_PHI, SMALL.taxels.surface, self.finder, follower, support=support, references=untouchable
        )

    def run(self, windows: int, felt: Force | npt.NDArray[np.floating] | float) -> None:
        """Let so many windows pass; the taxels feel ``felt(window)``, newtons, drift included."""
        for _ in range(windows):
            self.windows += 1
            felt_n = np.zeros(SMALL_PHI.shape[1]) + (felt(self.windows) if callable(felt) else felt)
            mean_n = SMALL_PHI.forward(felt_n) + self._random.normal(0, self.NOISE_N, SMALL_SUMS)
            self.window = Window(self.windows, mean_n, self._nothing, self._nothing, self.known)
            self.zero.take(self.window, self.known)
            if self.zero.needs_audit:
                self.zero.audit()

    @property
    def moved_n(self) -> Floats:
        """How far the zero has moved, each taxel, newtons."""
        return self.finder.find(self.zero.follower.level_n, self.known, self.NOISE_N).force_n
