"""The calibration of a running skin: a zero that is measured, followed, and doubted where it may be wrong.

Boards with adaptive sending measure and follow their own zero: then the zero here begins with 0. It moves when a person
settles what stands on the skin, and when that has gone.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Literal

import msgspec
import numpy as np
import numpy.typing as npt

from calibration.defects import DefectFinder, Defects, subject_of
from calibration.doubt import Doubt
from calibration.drift import SHORTEST_MEMORY, DriftFollower
from calibration.field import FieldFinder
from calibration.support import Support
from calibration.taring import Taring
from calibration.temperature import TemperatureModel
from calibration.windows import TARE_WINDOWS, Bools, Floats, Window, WindowMeans, rms, tare_s
from calibration.zero import Zero
from canskin.calibration_messages import CalibrationState, CalibrationStatus, Region, ZeroSupport
from canskin.messages import Measurement
from skin.clipping import IDLE_MEAN
from skin.frontend import sum_step_n
from skin.layout import Layout
from skin.measured_sums import used_sums
from skin.taxel import NOISE_N

#: When the zero is measured: as soon as the skin has been untouched for a while, or on request alone.
Tare = Literal["at-start", "never"]
#: Noise of sums that are not averaged, in units of what the paper's sensor has: below, the sensor adds none.
LEAST_NOISE_RATIO: Final = 0.3
#: No noise is taken to be less than this part of a count: sums are whole numbers of counts.
LEAST_STEP: Final = 0.3
#: From one look at the newest adaptive sums to the next, seconds: the period of their cycles here.
LOOK_S: Final = 0.025
#: Noise of a sum, counts, that is no defect: averages of an untouched taxel are 0 but for rare cycles.
QUIET_COUNTS: Final = 3.0
#: Windows without cycles of all sums after which they are asked for, where nodes have two states.
LONGEST_GAP: Final = 60
#: Least correction below zero that is logged, as part of the range, and least time between two such lines.
LOGGED_RATIO: Final = 0.01
LOGGED_NS: Final = 10_000_000_000


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
    """Learns the zero of the sums of a skin, and writes it into measurements.

    `apply` to every measurement, then `take` the one that came; `work` whenever there is time for a window
    (`gateway.service.SPARE_S`). Of adaptive sums, `take` the newest every `LOOK_S`, with the time of the look.

    Parameters
    ----------
    layout : Layout
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
        Number of times the zero was measured, told, loaded or forgotten.
    """

    def __init__(
        self,
        layout: Layout,
        *,
        offsets_n: Floats | None = None,
        tares: bool = True,
        say: Callable[[str], None] = lambda _: None,
    ) -> None:
        taxels, self._phi = layout.taxels, layout.phi()
        self._shape = taxels.rows, taxels.columns
        #: Whether offsets are measured and followed here, and not by the boards.
        self._is_own = not layout.sends.boards_keep_zero
        self._tares = tares
        self._say = say
        self._newton_per_count, self._force_max_n = taxels.newton_per_count, taxels.force_max_n
        self._period_s = layout.sync.period_s if self._is_own else LOOK_S
        self._clips = layout.samples_per_sync == 1 and not taxels.is_analogue
        self._windows = WindowMeans(self._phi.shape[0], self._period_s, self._newton_per_count)
        self._finder = FieldFinder(self._phi, *self._shape)
        self._references = np.isin(np.arange(taxels.count), taxels.untouchable or ())
        nothing = np.zeros(self._phi.shape[0])
        self._finder.find(nothing, nothing == 0, 1.0)  # compiles: no gateway waits for that in a cycle
        self._step_n = sum_step_n(layout)
        self._defects = Defects(np.ones(self._phi.shape[0], np.bool_))
        self._defect_finder = DefectFinder(self._phi, taxels.columns, QUIET_COUNTS * self._step_n)
        self._doubt = self._new_doubt()
        self._doubtful = b""
        self._waiting: Window | None = None
        self._newest_ns = self._needs_until_ns = self._logged_ns = 0
        self._taring = Taring(self._finder, LEAST_STEP * self._step_n)
        self._zero: Zero | None = None
        self._support = Support(self._phi)
        self._temperature = TemperatureModel(self._phi.blocks)
        self._centre_ns = self._tared_ns = 0
        self._noise_n = 0.0
        self._bias_n: Floats | float = 0.0
        self._first_n = np.zeros(self._phi.shape[0])
        self.state = CalibrationState.MEASURING if self._tares else CalibrationState.OFF
        self._offsets = b""
        self._begin_at_boards()
        self.revision = 0
        if offsets_n is not None:
            self.load(offsets_n)
        self.result: TareResult | None = None
        self._tell_doubt()

    @property
    def offsets_n(self) -> Floats | None:
        """Offsets of the sums in newtons, shape (m,), NaN for unknown ones; None without any."""
        if self._zero is None:
            return None
        return np.where(self._zero.follower.known, self._zero.follower.level_n, np.nan)

    @property
    def tare_s(self) -> float:
        """Time for which the skin must be untouched, seconds."""
        return tare_s(self._period_s)

    @property
    def has_few_sums(self) -> bool:
        """Whether a zero waits for valid sums."""
        return self._taring.has_few_sums

    @property
    def doubtful(self) -> Bools:
        """Taxels whose force may be an error of the zero, shape (n,)."""
        return self._doubt.taxels

    def load(self, offsets_n: Floats) -> None:
        """Take stored offsets, shape (m,), newtons; NaN for unknown ones."""
        known = np.isfinite(offsets_n)
        self._start_anew(TareResult(False, "other offsets were loaded meanwhile"))
        self._begin(np.where(known, offsets_n, 0.0), np.zeros(known.size), known, 0, 0.0, ZeroSupport.STORED)
        if not self._tares:
            self.state = CalibrationState.LOADED

    def take_temperatures(self, kelvin: Floats) -> None:
        """Take the temperatures of the boards, kelvin, shape (blocks,); NaN where unknown. The zero follows them."""
        zero, phi = self._zero, self._phi
        if zero is None or not self._tares or not self._is_own:
            return
        level_n = np.where(zero.follower.known, zero.follower.level_n, np.nan)
        self._first_n = np.where(np.isnan(self._first_n), level_n, self._first_n)  # blocks may come late
        totals = (phi.row_of_sum == 0) & zero.follower.known
        if not totals.any():
            return
        way_n = (level_n - self._first_n)[totals] / phi.block_size
        of_blocks = np.full(phi.blocks, np.nan)
        of_blocks[phi.block_of_sum[totals]] = way_n
        change_n = self._temperature.take(kelvin, of_blocks)[phi.block_of_taxel]
        if change_n.any():
            zero.move(change_n)
            self._doubt.move(change_n)

    def forget(self) -> None:
        """Drop all offsets and measure the zero as at the start, after nodes have begun to correct otherwise."""
        self._start_anew(TareResult(False, "the nodes were written to meanwhile"))
        self._zero = None
        self._support = Support(self._phi)
        self._doubt = self._new_doubt()
        self._begin_at_boards()

    def _start_anew(self, result: TareResult) -> None:
        """Go back to the state of the start; `result` ends a measurement of the zero."""
        is_measuring = self.state in {CalibrationState.MEASURING, CalibrationState.TOUCHED}
        self._tare()
        self.revision += 1
        self.result = result if is_measuring else None
        self._centre_ns = self._tared_ns = 0
        if not self._tares:
            self.state = CalibrationState.OFF

    def tare(self, *, force: bool = False, region: Region | None = None) -> None:
        """Measure the zero anew; `result` has the outcome, None meanwhile.

        What stands still and is doubtful is part of the new zero: who asks for one says that nothing touches the skin.

        Parameters
        ----------
        force : bool
            Whatever touches the skin is part of its zero.
        region : tuple of int, optional
            Whatever stands in this part of the skin is part of its zero; the rest of the skin keeps its zero.
        """
        self._tare(asked=True, force=force, region=region)

    def _tare(self, *, asked: bool = False, force: bool = False, region: Region | None = None) -> None:
        self.result, chosen = None, None
        if region is not None:
            top, left, bottom, right = region
            chosen = np.zeros(self._shape, np.bool_)
            chosen[top : bottom + 1, left : right + 1] = True
        self._taring.begin(asked=asked, forced=force, region=None if chosen is None else chosen.ravel())
        self._waiting = None
        self._windows.restart()
        self.state = CalibrationState.MEASURING

    def apply(self, measurement: Measurement, sums: npt.NDArray[np.intp] | slice = slice(None)) -> Measurement:
        """Return a measurement with the offsets of its instant, and without sums that are defective or have none.

        `sums` are the places of its sums among those of Φ, if it has only some of them.
        """
        if self._zero is None or not self._is_own:
            if not self._offsets and not self._doubtful:
                return measurement
            return msgspec.structs.replace(measurement, offsets=self._offsets, doubtful=self._doubtful)
        ahead = (measurement.sampled_mono_ns - self._centre_ns) / self._windows.length_ns if self._centre_ns else 0.0
        follower = self._zero.follower
        offsets = np.rint(follower.predicted_n(ahead)[sums] / self._newton_per_count).astype("<i4")
        usable = (self._defects.usable & follower.known)[sums]
        if measurement.usable:
            usable &= np.frombuffer(measurement.usable, np.uint8) != 0
        return msgspec.structs.replace(
            measurement,
            offsets=offsets.tobytes(),
            usable=b"" if usable.all() else usable.astype(np.uint8).tobytes(),
            doubtful=self._doubtful,
        )

    def take(self, measurement: Measurement) -> None:
        """Learn from a measurement as it came, without saturated sums; most of it is left to `work`."""
        if self.state in {CalibrationState.OFF, CalibrationState.LOADED}:
            return
        counts = np.frombuffer(measurement.sums, "<i4")
        window = self._windows.take(measurement.sampled_mono_ns, counts, used_sums(measurement, self._phi))
        if window is not None:
            for _ in range(2):  # what has not been done by now: the window before, and what is due after that
                self.work()
            self._waiting = window

    def work(self) -> None:
        """Learn from the newest window, or audit the zero."""
        window, self._waiting = self._waiting, None
        if window is None:
            if self._zero is not None and self._zero.needs_audit:
                self._doubt.move(self._zero.audit())
            return
        self._newest_ns = window.centre_ns
        self._noise_n = float(np.median(window.noise_n[window.known])) if window.known.any() else 0.0
        if not self._tared_ns:  # a stored zero has none
            self._bias_n = self._clip_bias_n()
        if self._zero is not None and self._tares:
            self._follow(self._zero, window._replace(mean_n=window.mean_n - self._bias_n))
        if self.state is not CalibrationState.FOLLOWING:
            self._measure(window)
        self._tell_doubt()

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
        length_ns = self._windows.length_ns
        if now_ns - self._newest_ns > LONGEST_GAP * length_ns:
            windows = TARE_WINDOWS
            if self.state is CalibrationState.FOLLOWING and self._zero is not None:  # late blocks need a zero in a row
                windows = SHORTEST_MEMORY if self._zero.follower.known.all() else TARE_WINDOWS + 2
            self._needs_until_ns = now_ns + windows * length_ns
        return now_ns < self._needs_until_ns

    def status(self) -> CalibrationStatus:
        """Return what is known for `canskin.messages.GatewayStatus`."""
        offsets_n, zero, doubt = self.offsets_n, self._zero, self._doubt
        known_n = np.zeros(0) if offsets_n is None else offsets_n[np.isfinite(offsets_n)]
        per_s = 1e9 / self._windows.length_ns
        return CalibrationStatus(
            state=self.state,
            tared_mono_ns=self._tared_ns,
            known_sums=known_n.size,
            offset_rms_n=rms(known_n),
            drift_rms_n_per_s=rms(zero.follower.slope_n) * per_s if zero is not None else 0.0,
            noise_n=self._noise_n,
            held_blocks=int(zero.held.sum()) if zero is not None else 0,
            defects=self._defects.words,
            revision=self.revision,
            zero_support=self._support.of_blocks.tobytes(),
            zero_mono_ns=self._support.since_ns.astype("<i8").tobytes(),
            doubtful_taxels=int(doubt.taxels.sum()),
            doubtful_force_n=doubt.force_n,
            doubtful_since_mono_ns=doubt.since_ns,
        )

    def _follow(self, zero: Zero, window: Window) -> None:
        """Follow the zero, and doubt what stands on the skin."""
        length_ns = self._windows.length_ns
        skipped = round((window.centre_ns - self._centre_ns) / length_ns) - 1 if self._centre_ns else 0
        if skipped > 0:
            zero.skip(skipped)
        zero.take(window, self._defects.usable)
        self._centre_ns = window.centre_ns
        if self._is_own:  # adaptive sums rarely change
            self._look_for_defects(window, zero.held)
        self._doubt.move(zero.moved_n)
        was_doubtful = self._doubt.since_ns
        self._doubt.take(zero.force_n, window.centre_ns)
        self._support.take(zero, window)
        self._log(zero, was_doubtful)

    def _log(self, zero: Zero, was_doubtful_ns: int) -> None:
        """Log what was corrected, and what is doubtful."""
        fall_n, doubt = -float(zero.moved_n.min()), self._doubt
        if fall_n > LOGGED_RATIO * self._force_max_n and self._centre_ns > self._logged_ns + LOGGED_NS:
            self._logged_ns = self._centre_ns
            self._say(f"forces of up to {1e3 * fall_n:.2g} mN a taxel below zero: the zero is corrected there")
        if doubt.since_ns and not was_doubtful_ns:
            row, column = divmod(int(np.argmax(np.where(doubt.taxels, zero.force_n, 0))), self._shape[1])
            self._say(
                f"a force around row {row}, column {column} stands still: a still weight, or the zero has risen there;"
                " marked as doubtful until it moves, ends, or 'skin tare --region' settles it"
            )
        elif was_doubtful_ns and not doubt.since_ns:
            self._say("no force is doubtful any more")

    def _tell_doubt(self) -> None:
        """Pack the doubtful taxels for measurements: without a zero that is to be measured, all.

        Also the offsets of adaptive sums, which change in some windows only.
        """
        if self._zero is not None and not self._is_own:
            offsets = np.rint(self._zero.follower.level_n / self._newton_per_count).astype("<i4")
            self._offsets = offsets.tobytes() if offsets.any() else b""
        all_doubtful = self._tares and self._zero is None
        taxels = np.ones_like(self._doubt.taxels) if all_doubtful else self._doubt.taxels
        self._doubtful = np.packbits(taxels).tobytes() if taxels.any() else b""

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
        zero, region, forced = self._zero, self._taring.region, self._taring.forced
        before_n = None if zero is None else np.where(zero.follower.known, zero.follower.predicted_n(0.0), np.nan)
        if before_n is not None:
            before_n = before_n + self._bias_n
        found = self._taring.take(window, before_n, self._doubt.taxels, has_common=not self._tared_ns)
        if found is None:
            return
        if found.touched is not None:
            self._refuse(*divmod(found.touched, self._shape[1]))
            return
        if region is None and not self._is_own:
            region = np.ones(self._doubt.taxels.size, np.bool_)
        if region is not None:
            self._settle(found.mean_n, found.known, region)
            return
        self._bias_n = self._clip_bias_n()
        known, level_n = found.known, found.level_n - self._bias_n
        slope_n = found.slope_n if self._tares else np.zeros_like(level_n)  # nothing follows the drift then
        support = ZeroSupport.TOLD if forced else ZeroSupport.MEASURED
        self._begin(np.where(known, level_n, 0.0), slope_n, known, TARE_WINDOWS, found.noise_n, support)
        self._end(
            f"zero of {int(known.sum())} of {known.size} sums: offsets {1e3 * rms(level_n[known]):.2f} mN rms,"
            f" up to {1e3 * float(np.abs(level_n[known]).max()):.2f} mN; noise {1e3 * self._noise_n:.2f} mN"
        )

    def _settle(self, mean_n: Floats, known: Bools, region: Bools) -> None:
        """Take what stands in a part of the skin for its zero."""
        if self._zero is None:
            self._taring.begin()
            self._tell(is_done=False, text="the skin has no zero yet: measure that of all of the skin first")
            return
        moved_n = self._zero.settle(mean_n - self._bias_n, known & self._defects.usable, region)
        self._doubt.move(moved_n)
        self._support.tell(region, self._newest_ns)
        self._end(f"zero of {int(region.sum())} taxels: moved by up to {1e3 * np.abs(moved_n).max():.2f} mN")

    def _new_doubt(self) -> Doubt:
        return Doubt(self._phi.shape[1], self._force_max_n, self._windows.length_ns * 1e-9)

    def _end(self, text: str) -> None:
        """End a measurement of the zero that has succeeded."""
        self._taring.begin()
        self._centre_ns = self._tared_ns = self._newest_ns
        self.revision += 1
        self.state = CalibrationState.FOLLOWING if self._tares else CalibrationState.LOADED
        self._tell(is_done=True, text=text)

    def _refuse(self, row: int, column: int) -> None:
        """Keep the zero there is; try again with the next window unless there is one."""
        text = (
            f"something touches the skin or moves on it, around row {row}, column {column}: its zero is"
            f" measured when it has been untouched for {self.tare_s:.3g} s"
        )
        if self._tares and (self._tared_ns or not self._is_own):
            self.state = CalibrationState.FOLLOWING
            self._taring.begin()
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
        if not self._clips or self._noise_n < LEAST_NOISE_RATIO * NOISE_N * size**0.5:
            return 0.0
        return np.where(self._phi.row_of_sum == 0, size * IDLE_MEAN * NOISE_N, 0.0)

    def _begin_at_boards(self) -> None:
        """Begin with a zero of 0 where the boards take theirs off."""
        if self._is_own:
            return
        self._offsets = b""
        zeros = np.zeros(self._phi.shape[0])
        self._begin(zeros, zeros, np.ones(zeros.size, np.bool_), 1, 0.0, ZeroSupport.STORED)
        if self._tares:
            self.state = CalibrationState.FOLLOWING

    def _begin(  # noqa: PLR0917
        self, level_n: Floats, slope_n: Floats, known: Bools, age: int, noise_n: float, support: ZeroSupport
    ) -> None:
        """Begin with a zero."""
        phi = self._phi
        follower = DriftFollower(
            phi.block_of_sum,
            phi.blocks,
            level_n,
            slope_n,
            known,
            age=age,
            noise_n=noise_n,
            least_noise_n=LEAST_STEP * self._step_n,
        )
        self._zero = Zero(
            phi,
            *self._shape,
            self._finder,
            follower,
            support=support,
            references=self._references,
            follows=self._is_own,
        )
        self._support.begin(known, support, self._newest_ns)
        self._doubt = self._new_doubt()
        self._first_n = np.where(known, level_n, np.nan)
        self._temperature.restart()
