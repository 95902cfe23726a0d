"""The calibration of a running skin: zero at the start and on request, drift afterwards, held under a touch."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Literal

import msgspec
import numpy as np
import numpy.typing as npt

from calibration.defects import DefectFinder, Defects, subject_of
from calibration.drift import LONGEST_GAP, LONGEST_HELD, SHORTEST_MEMORY, DriftFollower, line_through
from calibration.touched import Touch, TouchFinder
from calibration.windows import TARE_WINDOWS, Bools, Floats, Window, WindowMeans, change, rms, tare_s, typical, window_s
from canskin.calibration_messages import CalibrationState, CalibrationStatus
from canskin.messages import Measurement
from skin.clipping import IDLE_MEAN
from skin.frontend import sum_step_n
from skin.layout import Layout
from skin.measured_sums import used_sums
from skin.taxel import NOISE_N

#: When the zero is measured: as soon as the skin has been untouched for a while, or on request alone.
Tare = Literal["at-start", "never"]
#: Sums with a zero, part of all, with which the skin counts as tared; the others follow when their blocks are valid.
LEAST_KNOWN: Final = 0.5
#: Forces below zero for so many windows: the zero was measured under a touch. Twice as many after every attempt that
#: found a touch, up to `LONGEST_HELD`.
NEGATIVE_WINDOWS: Final = 4
#: Noise of sums that are not averaged, in units of what the paper's sensor has: below, the sensor adds none.
LEAST_NOISE_RATIO: Final = 0.3
#: No noise is taken to be less than this part of a count: sums are whole numbers of counts.
LEAST_STEP: Final = 0.3
#: Sums with a noise of so many counts have no defect: averages of an untouched taxel are 0 but for rare cycles.
QUIET_COUNTS: Final = 3.0


@dataclass(frozen=True)
class TareResult:
    """What a measurement of the zero has found.

    Attributes
    ----------
    is_done : bool
        Whether there is a new zero.
    text : str
        The result in words.
    """

    is_done: bool
    text: str


class Calibrator:
    """Learns the offsets of the sums of a skin with synchronous sending, and writes them into measurements.

    `apply` to every measurement, then `take` the one that came; `work` whenever there is a millisecond to spare.

    Parameters
    ----------
    layout : Layout
        With adaptive sending nothing is done: the nodes follow their offsets themselves.
    offsets_n : array, shape (m,), optional
        Stored offsets, newtons; NaN for unknown ones.
    tares : bool
        Measure the zero at the start, and follow it. Otherwise stored offsets stay as they are.
    say : callable
        Writes a line to the log.

    Attributes
    ----------
    state : CalibrationState
    result : TareResult or None
        Of the newest measurement of the zero that has ended.
    revision : int
        Number of times the zero was measured, loaded or forgotten.
    """

    def __init__(
        self,
        layout: Layout,
        *,
        offsets_n: Floats | None = None,
        tares: bool = True,
        say: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._phi = layout.phi()
        self._is_on = layout.sending == "synchronous"
        self._averages = layout.samples_per_sync > 1
        self._tares = tares and self._is_on
        self._say = say
        self._newton_per_count = layout.taxels.newton_per_count
        self._period_s = layout.sync.period_s
        self._windows = WindowMeans(self._phi.shape[0], self._period_s, self._newton_per_count)
        self._finder = TouchFinder(self._phi, layout.taxels.rows, layout.taxels.columns)
        self._reads_sums = layout.taxels.is_analogue
        self._step_n = sum_step_n(layout)
        least_n = QUIET_COUNTS * self._step_n
        self._defects = Defects(np.ones(self._phi.shape[0], np.bool_))
        self._defect_finder = DefectFinder(self._phi, layout.taxels.columns, least_n)
        self._waiting: Window | None = None
        self._newest_ns = self._needs_until_ns = self._centre_ns = self._tared_ns = 0
        self._measured, self._recent = (deque[Window](maxlen=TARE_WINDOWS) for _ in range(2))
        self._still = np.zeros(self._phi.blocks, np.intp)
        self._forced = False
        self._may_hold_a_touch = False  # the zero was forced, and nothing has shown since that it is adrift
        self._follower: DriftFollower | None = None
        self._negative = self._held_blocks = 0
        self._patience = NEGATIVE_WINDOWS
        self._noise_n = self._valid_ratio = 0.0
        self.temperatures_k: Floats = np.full(self._phi.blocks, np.nan)
        self._bias_n: Floats | float = 0.0
        self.state = CalibrationState.MEASURING if self._tares else CalibrationState.OFF
        self.revision = 0
        if offsets_n is not None:
            self.load(offsets_n)
        self.result: TareResult | None = None

    @property
    def offsets_n(self) -> Floats | None:
        """Offsets of the sums in newtons, shape (m,), NaN for unknown ones; None without any."""
        if self._follower is None:
            return None
        return np.where(self._follower.known, self._follower.level_n, np.nan)

    @property
    def _known(self) -> Bools:
        """Sums with an offset."""
        return np.zeros(self._phi.shape[0], np.bool_) if self._follower is None else self._follower.known

    @property
    def tare_s(self) -> float:
        """Time for which the skin must be untouched, seconds."""
        return tare_s(self._period_s)

    @property
    def has_few_sums(self) -> bool:
        """Whether a zero waits for valid sums."""
        return self._valid_ratio < LEAST_KNOWN

    @property
    def noise_n(self) -> float:
        """Median noise of one cycle's sum, newtons; 0 if unknown."""
        return self._noise_n

    def load(self, offsets_n: Floats) -> None:
        """Take stored offsets, shape (m,), newtons; NaN for unknown ones."""
        known = np.isfinite(offsets_n)
        self._start_anew(TareResult(False, "other offsets were loaded meanwhile"))
        self._follower = self._new_follower(np.where(known, offsets_n, 0.0), np.zeros(known.size), known, 1, 0.0)
        if not self._tares:
            self.state = CalibrationState.LOADED

    def take_temperatures(self, kelvin: Floats) -> None:
        """Keep the temperatures of the boards, kelvin, shape (blocks,); NaN where unknown."""
        self.temperatures_k = kelvin

    def forget(self) -> None:
        """Drop all offsets and measure the zero as at the start, after nodes have begun to correct otherwise."""
        self._start_anew(TareResult(False, "the nodes were written to meanwhile"))
        self._follower = None

    def _start_anew(self, result: TareResult) -> None:
        """Go back to the state of the start; `result` ends a measurement of the zero."""
        is_measuring = self.state in {CalibrationState.MEASURING, CalibrationState.TOUCHED}
        self.tare()
        self.revision += 1
        self.result = result if is_measuring else None
        self._centre_ns = self._tared_ns = self._negative = 0
        if not self._tares:
            self.state = CalibrationState.OFF

    def tare(self, *, force: bool = False) -> None:
        """Measure the zero anew; `result` has the outcome, None meanwhile.

        Parameters
        ----------
        force : bool
            Whatever touches the skin is part of its zero.
        """
        self.result, self._forced = None, force
        self._valid_ratio = 0.0
        self._measured.clear()
        self._waiting = None
        self._windows.restart()
        self.state = CalibrationState.MEASURING

    def apply(self, measurement: Measurement, sums: npt.NDArray[np.intp] | slice = slice(None)) -> Measurement:
        """Return a measurement with the offsets of its instant, and without sums that are defective or have none.

        `sums` are the places of its sums among those of Φ, if it has only some of them.
        """
        offsets = self._offsets_at(measurement.sampled_mono_ns)
        if offsets is None:
            return measurement
        offsets, usable = offsets[sums], (self._defects.usable & self._known)[sums]
        if measurement.usable:
            usable &= np.frombuffer(measurement.usable, np.uint8) != 0
        return msgspec.structs.replace(
            measurement,
            offsets=offsets.astype("<i4").tobytes(),
            usable=b"" if usable.all() else usable.astype(np.uint8).tobytes(),
        )

    def take(self, measurement: Measurement) -> None:
        """Learn from a measurement as it came, without saturated sums; most of it is left to `work`."""
        if not self._is_on or (self.state in {CalibrationState.OFF, CalibrationState.LOADED}):
            return
        counts = np.frombuffer(measurement.sums, "<i4")
        window = self._windows.take(measurement.sampled_mono_ns, counts, used_sums(measurement, self._phi))
        if window is not None:
            self.work()  # what has not been done by now
            self._waiting = window

    def work(self) -> None:
        """Learn from the newest window; takes about a millisecond."""
        window, self._waiting = self._waiting, None
        if window is None:
            return
        self._newest_ns = window.centre_ns
        self._noise_n = float(np.median(window.noise_n[window.known])) if window.known.any() else 0.0
        if self._follower is not None and self._centre_ns and self._tares:
            self._follow(self._follower, window)
        if self.state is not CalibrationState.FOLLOWING:
            self._measure(window)

    def needs_cycles(self, now_ns: int) -> bool:
        """Tell whether cycles of all sums should come now, where they do not come all the time.

        While the zero is measured; then for some windows after every `LONGEST_GAP` windows without any.

        Parameters
        ----------
        now_ns : int
            On the clock of the measurements.
        """
        if self.state not in {CalibrationState.TOUCHED, CalibrationState.FOLLOWING}:
            return self.state is CalibrationState.MEASURING
        length_ns = round(1e9 * window_s(self._period_s))
        if now_ns - self._newest_ns > LONGEST_GAP * length_ns:
            windows = TARE_WINDOWS if self.state is CalibrationState.TOUCHED else SHORTEST_MEMORY
            self._needs_until_ns = now_ns + windows * length_ns
        return now_ns < self._needs_until_ns

    def status(self) -> CalibrationStatus:
        """Return what is known for `canskin.messages.GatewayStatus`."""
        offsets_n, follower = self.offsets_n, self._follower
        known_n = np.zeros(0) if offsets_n is None else offsets_n[np.isfinite(offsets_n)]
        per_s = 1e9 / self._windows.length_ns
        return CalibrationStatus(
            state=self.state,
            tared_mono_ns=self._tared_ns,
            known_sums=known_n.size,
            offset_rms_n=rms(known_n),
            drift_rms_n_per_s=rms(follower.slope_n) * per_s if follower is not None else 0.0,
            noise_n=self._noise_n,
            held_blocks=self._held_blocks,
            defects=self._defects.words,
            revision=self.revision,
        )

    def _offsets_at(self, time_ns: int) -> npt.NDArray[np.int32] | None:
        if self._follower is None:
            return None
        ahead = (time_ns - self._centre_ns) / self._windows.length_ns if self._centre_ns else 0.0
        return np.rint(self._follower.predicted_n(ahead) / self._newton_per_count).astype(np.int32)

    def _follow(self, follower: DriftFollower, window: Window) -> None:
        """Follow the drift of blocks that nothing touches."""
        skipped = round((window.centre_ns - self._centre_ns) / self._windows.length_ns) - 1
        if skipped > 0:
            follower.skip(skipped)
            self._still[:] = 0
        mean_n = window.mean_n - self._bias_n
        known = window.known & follower.known & self._defects.usable
        touch = self._finder.look(mean_n - follower.predicted_n(1.0), known, follower.noise_n)
        # Forces below a forced zero are of a touch that has gone. Lines that followed would overshoot the true zero.
        held = touch.blocks | (self._may_hold_a_touch and touch.is_negative)
        follower.take(mean_n, window.known, held)
        self._begin_late(follower, window._replace(mean_n=mean_n), touch.blocks)
        self._look_for_defects(window, touch.blocks)
        self._centre_ns = window.centre_ns
        self._held_blocks = int(held.sum())
        self._negative = self._negative + 1 if touch.is_negative else 0
        if self._negative >= self._patience and self.state is CalibrationState.FOLLOWING:
            self._negative = 0
            self._patience = min(2 * self._patience, LONGEST_HELD)
            self._say("forces below zero: what touched the skin when its zero was measured is gone; measures it anew")
            self.tare()

    def _begin_late(self, follower: DriftFollower, window: Window, held: Bools) -> None:
        """Give blocks that came late their zero, by the same test as at the start."""
        self._recent.append(window)
        late = ~self._phi.all_of_blocks(follower.known)
        self._still = np.where(late & ~held & self._phi.all_of_blocks(window.known), self._still + 1, 0)
        ready = self._still >= TARE_WINDOWS
        if not ready.any():
            return
        means_n = np.stack([each.mean_n for each in self._recent])
        level_n, slope_n, _ = line_through(means_n)
        sums = self._phi.sums_of_blocks(ready)
        known = np.logical_and.reduce([each.known for each in self._recent]) & (follower.known | sums)
        changed_n = change(means_n)
        touched = np.zeros_like(ready)
        for each_n in (np.where(sums, level_n, follower.level_n), changed_n, -changed_n):
            touched |= self._finder.look(each_n, known, follower.noise_n).blocks
        free = ready & ~touched
        if free.any():
            follower.begin(self._phi.sums_of_blocks(free), level_n, slope_n, TARE_WINDOWS)

    def _look_for_defects(self, window: Window, held: Bools) -> None:
        """Find defects; log those that are new."""
        found = self._defect_finder.take(window, held)
        told = {subject_of(each) for each in self._defects.words}
        for text in found.words:
            if subject_of(text) not in told:
                self._say(text)
        self._defects = found

    def _measure(self, window: Window) -> None:
        """Measure the zero, when the skin has been untouched for long enough."""
        self._measured.append(window)
        self._valid_ratio = float(window.known.mean())
        known = np.logical_and.reduce([each.known for each in self._measured])
        if len(self._measured) < TARE_WINDOWS or known.mean() < LEAST_KNOWN:
            return
        means_n = np.stack([each.mean_n for each in self._measured])
        level_n, slope_n, deviation_n = line_through(means_n)
        noise_n = typical(deviation_n[known])
        touch = None if self._forced else self._touch_of(means_n, level_n, known, noise_n)
        if touch is not None:
            self._refuse(touch)
            return
        self._bias_n = self._clip_bias_n()
        level_n -= self._bias_n
        slope_n = slope_n if self._tares else np.zeros_like(slope_n)  # nothing follows the drift then
        self._follower = self._new_follower(np.where(known, level_n, 0.0), slope_n, known, TARE_WINDOWS, noise_n)
        self._measured.clear()
        self._still[:] = 0
        self._centre_ns = window.centre_ns
        self._patience = NEGATIVE_WINDOWS
        self._may_hold_a_touch = self._forced
        self._tared_ns = window.centre_ns
        self.revision += 1
        self.state = CalibrationState.FOLLOWING if self._tares else CalibrationState.LOADED
        self._tell(
            is_done=True,
            text=f"zero of {int(known.sum())} of {known.size} sums: offsets {1e3 * rms(level_n[known]):.2f} mN rms,"
            f" up to {1e3 * float(np.abs(level_n[known]).max()):.2f} mN; noise {1e3 * self._noise_n:.2f} mN",
        )

    def _touch_of(self, means_n: Floats, level_n: Floats, known: Bools, noise_n: float) -> Touch | None:
        """Return what touches the skin or moves on it, None for nothing."""
        moved = self._finder.look(change(means_n), known, noise_n)
        if moved.is_touched or moved.is_negative:
            return moved
        follower = self._follower
        if follower is None:
            still = self._finder.look(level_n, known, noise_n)
        else:
            still = self._finder.look(level_n - follower.predicted_n(0.0), known & follower.known, noise_n)
        return still if still.is_touched else None

    def _refuse(self, touch: Touch) -> None:
        """Keep the zero there is; try again with the next window unless there is one."""
        text = (
            f"something touches the skin or moves on it, around row {touch.row}, column {touch.column}: its zero is"
            f" measured when it has been untouched for {self.tare_s:.3g} s"
        )
        if self._tared_ns and self._tares:
            self._may_hold_a_touch &= touch.is_touched  # forces that go down without a touch are adrift
            self.state = CalibrationState.FOLLOWING
            self._measured.clear()
            self._tell(is_done=False, text=text.split(":", maxsplit=1)[0] + ": the zero stays as it was")
            return
        if self.state is not CalibrationState.TOUCHED:
            self.state = CalibrationState.TOUCHED
            self._tell(is_done=False, text=text)

    def _tell(self, *, is_done: bool, text: str) -> None:
        self.result = TareResult(is_done, text)
        self._say(text)

    def _clip_bias_n(self) -> Floats | float:
        """Return what sums of an untouched skin read by clipped noise, as solvers and models expect it.

        Nodes that average undo it themselves; an analogue front end clips no taxel.
        """
        size = self._phi.block_size
        if self._averages or self._reads_sums or self._noise_n < LEAST_NOISE_RATIO * NOISE_N * size**0.5:
            return 0.0
        return np.where(self._phi.row_of_sum == 0, size * IDLE_MEAN * NOISE_N, 0.0)

    def _new_follower(self, level_n: Floats, slope_n: Floats, known: Bools, age: int, noise_n: float) -> DriftFollower:
        least_n = LEAST_STEP * self._step_n
        phi = self._phi
        return DriftFollower(
            phi.block_of_sum, phi.blocks, level_n, slope_n, known, age=age, noise_n=noise_n, least_noise_n=least_n
        )
