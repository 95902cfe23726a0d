"""The calibration of a running skin: a zero that is measured, followed, and doubted where it may be wrong.

Boards with steps measure and follow their own zero: then the zero here begins with 0. It moves when a person
settles what stands on the skin, and when that has gone.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Final, Literal

import msgspec
import numpy as np

from calibration.clipped_noise import ClippedNoise
from calibration.corrections import Corrections
from calibration.defects import DefectFinder
from calibration.field import FieldFinder
from calibration.followed import FollowedZero, Measured, ZeroLog, least_noise_n
from calibration.taring import Taring
from calibration.temperature import TemperatureModel
from calibration.windows import TARE_WINDOWS, Bools, Floats, Window, WindowMeans, rms
from canskin.calibration_messages import CalibrationState, CalibrationStatus, Region, ZeroSupport
from canskin.messages import Measurement
from skin.frontend import sum_step_n
from skin.layout import Layout
from skin.measured_sums import used_sums
from skin.regions import taxels_of

#: When the zero is measured: as soon as the skin has been untouched for a while, or on request alone.
Tare = Literal["at-start", "never"]
#: From one look at the newest steps to the next, seconds: the period of their cycles here.
LOOK_S: Final = 0.025
#: Noise of a sum, counts, that is no defect: averages of an untouched taxel are 0 but for rare cycles.
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
    """Learns the zero of the sums of a skin, and writes it into measurements.

    `apply` to every measurement, then `take` the one that came; `work` whenever there is time for a window
    (`gateway.service.SPARE_S`). Of steps, `take` the newest every `LOOK_S`, with the time of the look.

    Parameters
    ----------
    offsets_n : array, shape (m,), optional
        Stored offsets, newtons; NaN for unknown ones.
    tares : bool
        Measure the zero at the start, and follow it. Otherwise stored offsets stay as they are.
    say : callable
        Writes a line to the log.
    submit : callable
        Calls what compiles the kernels, at the first measurement, perhaps in another thread; nothing is learned before
        that has ended.

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
        submit: Callable[[Callable[[], None]], object] = lambda function: function(),
    ) -> None:
        taxels, phi = layout.taxels, layout.phi()
        self._layout, self._phi, self._tares, self._say = layout, phi, tares, say
        #: Whether offsets are measured and followed here, and not by the boards.
        self._is_own = not layout.sends.boards_keep_zero
        period_s = layout.sync.round_s if self._is_own else LOOK_S
        self._windows = WindowMeans(phi.shape[0], period_s, taxels.newton_per_count)
        self._waiting: Window | None = None
        self._newest_ns = self._tared_ns = 0
        self._noise = ClippedNoise(phi, clips=layout.samples_per_sync == 1 and not taxels.is_analogue)
        self._finder = FieldFinder(phi, taxels.surface)
        self._submit, self._has_begun, self._is_compiled = submit, False, False
        self._defects = DefectFinder(phi, taxels.surface, QUIET_COUNTS * sum_step_n(layout), say, taxels.force_max_n)
        self._left_out: Bools = np.zeros(phi.shape[0], np.bool_)
        self._taring = Taring(self._finder, least_noise_n(layout))
        temperature = TemperatureModel(phi.blocks)
        self._new_zero = partial(FollowedZero, layout, self._finder, temperature, self._windows.length_ns)
        self._log = ZeroLog(say, taxels.surface, taxels.force_max_n)
        self._corrections = Corrections(layout)
        self._followed: FollowedZero | None = None
        self.state = CalibrationState.MEASURING if tares else CalibrationState.OFF
        self.revision = 0
        self._drop()
        if offsets_n is not None:
            self.load(offsets_n)
        self.result: TareResult | None = None

    def _compile(self) -> None:
        """Find a field of nothing: no gateway waits for the kernels in a cycle."""
        nothing = np.zeros(self._phi.shape[0])
        FieldFinder(self._phi, self._layout.taxels.surface).find(nothing, nothing == 0, 1.0)
        self._is_compiled = True

    @property
    def offsets_n(self) -> Floats | None:
        """Offsets of the sums in newtons, shape (m,), NaN for unknown ones; None without any."""
        return None if self._followed is None else self._followed.offsets_n

    @property
    def tare_s(self) -> float:
        """Time for which the skin must be untouched, seconds."""
        return TARE_WINDOWS * self._windows.length_ns / 1e9

    @property
    def has_few_sums(self) -> bool:
        """Whether a zero waits for valid sums."""
        return self._taring.has_few_sums

    def load(self, offsets_n: Floats) -> None:
        """Take stored offsets, shape (m,), newtons; NaN for unknown ones."""
        known = np.isfinite(offsets_n)
        self._start_anew(TareResult(False, "other offsets were loaded meanwhile"))
        level_n = np.where(known, offsets_n, 0.0)
        stored = Measured(level_n, np.zeros(known.size), known, ZeroSupport.STORED, self._newest_ns)
        self._use(self._new_zero(stored))
        if not self._tares:
            self.state = CalibrationState.LOADED

    def take_temperatures(self, kelvin: Floats) -> None:
        """Take the temperatures of the boards, kelvin, shape (blocks,); NaN where unknown. The zero follows them."""
        if self._followed is not None and self._tares and self._is_own:
            self._followed.take_temperatures(kelvin)

    def forget_blocks(self, blocks: Bools) -> None:
        """Drop the offsets of some blocks, shape (blocks,), whose nodes have begun to correct otherwise.

        They come back with the next zero, or when nothing has touched these blocks for a while.
        """
        self._windows.restart()
        self._waiting = None
        self._taring.restart()
        if self._followed is not None and self._is_own:
            self._followed.forget(blocks)
            self.revision += 1

    def doubt_blocks(self, blocks: Bools, time_ns: int) -> None:
        """Doubt all forces on some blocks, shape (blocks,), from `time_ns` to the next call."""
        self._corrections.doubt(self._phi.of_taxels(blocks), time_ns)
        self._corrections.take(self._followed, tares=self._tares)

    @property
    def stands_still(self) -> Bools:
        """Blocks whose sums do not change any more, although they have noise, shape (blocks,)."""
        return self._defects.stands_still

    def leave_out(self, blocks: Bools) -> None:
        """Use no sums of some blocks, shape (blocks,), until the next call."""
        self._left_out = self._phi.sums_of_blocks(blocks)

    @property
    def _usable(self) -> Bools:
        return self._defects.found.usable & ~self._left_out

    def forget(self) -> None:
        """Drop all offsets and measure the zero as at the start, after nodes have begun to correct otherwise."""
        self._start_anew(TareResult(False, "the nodes were written to meanwhile"))
        self._drop()

    def _start_anew(self, result: TareResult) -> None:
        """Go back to the state of the start; `result` ends a measurement of the zero."""
        is_measuring = self.state in {CalibrationState.MEASURING, CalibrationState.TOUCHED}
        self.tare(asked=False)
        self.revision += 1
        self.result = result if is_measuring else None
        self._tared_ns = 0
        if not self._tares:
            self.state = CalibrationState.OFF

    def tare(self, *, force: bool = False, region: Region | str | None = None, asked: bool = True) -> None:
        """Measure the zero anew; `result` has the outcome, None meanwhile.

        Parameters
        ----------
        force : bool
            Whatever touches the skin is part of its zero.
        region : tuple of int, or str, optional
            Box or name (`skin.regions.taxels_of`). Whatever stands in this part of the skin is part of its zero; the
            rest of the skin keeps its zero.
        asked : bool
            What stands still and is doubtful is part of the new zero: who asks for one says that nothing touches the
            skin.
        """
        self.result, chosen = None, None if region is None else taxels_of(self._layout, region)
        self._taring.begin(asked=asked, forced=force, region=chosen)
        self._waiting = None
        self._windows.restart()
        self.state = CalibrationState.MEASURING

    def apply(self, measurement: Measurement) -> Measurement:
        """Return a measurement with the offsets of its instant.

        Sums that are defective or have no offset are not usable in it.
        """
        return self._corrections.apply(measurement, self._followed, self._usable)

    def take(self, measurement: Measurement) -> None:
        """Learn from a measurement as it came, without saturated sums; most of it is left to `work`."""
        if self.state in {CalibrationState.OFF, CalibrationState.LOADED}:
            return
        if not self._has_begun:
            self._has_begun = True
            self._submit(self._compile)
        if not self._is_compiled:
            return
        if measurement.cycle % self._layout.sync.turns:  # half of its sums come once more in the next one
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
            if self._followed is not None and self._is_compiled:
                self._followed.audit()
            return
        self._newest_ns = window.centre_ns
        self._noise.take(window)
        if not self._tared_ns:  # a stored zero has none
            self._noise.learn_bias()
        if self._followed is not None and self._tares:
            self._follow(self._followed, window)
        if self.state is not CalibrationState.FOLLOWING:
            self._measure(window)
        self._corrections.take(self._followed, tares=self._tares)

    def status(self) -> CalibrationStatus:
        """Return what is known for `canskin.messages.GatewayStatus`."""
        status = CalibrationStatus(
            state=self.state,
            tared_mono_ns=self._tared_ns,
            noise_n=self._noise.noise_n,
            defects=self._defects.found.words,
            revision=self.revision,
            zero_support=bytes(self._phi.blocks),
            zero_mono_ns=bytes(8 * self._phi.blocks),
        )
        unaccepted, since_ns = self._corrections.unaccepted, self._corrections.unaccepted_ns
        if self._followed is None:
            count = int(unaccepted.sum())
            return msgspec.structs.replace(status, doubtful_taxels=count, doubtful_since_mono_ns=since_ns)
        zero, doubt, support = self._followed.zero, self._followed.doubt, self._followed.support
        known_n = zero.follower.level_n[zero.follower.known]
        per_s = 1e9 / self._windows.length_ns
        doubtful = doubt.taxels | unaccepted
        return msgspec.structs.replace(
            status,
            known_sums=known_n.size,
            offset_rms_n=rms(known_n),
            drift_rms_n_per_s=rms(zero.follower.slope_n) * per_s,
            held_blocks=int(zero.held.sum()),
            zero_support=support.of_blocks.tobytes(),
            zero_mono_ns=support.since_ns.astype("<i8").tobytes(),
            doubtful_taxels=int(doubtful.sum()),
            doubtful_force_n=float(zero.force_n[doubtful].sum()),
            doubtful_since_mono_ns=min(filter(None, (doubt.since_ns, since_ns)), default=0),
        )

    def _follow(self, followed: FollowedZero, window: Window) -> None:
        """Follow the zero, and look for defects."""
        followed.take(window._replace(mean_n=window.mean_n - self._noise.bias_n), self._usable)
        if self._is_own:  # steps rarely change
            self._defects.take(window, followed.zero.held)
        self._log.tell(followed)

    def _measure(self, window: Window) -> None:
        """Measure the zero, when the skin has been untouched for long enough."""
        region, followed, taxels = self._taring.region, self._followed, self._layout.taxels
        before_n = None if followed is None else followed.offsets_n + self._noise.bias_n
        settled = np.zeros(taxels.count, np.bool_) if followed is None else followed.doubt.taxels
        found = self._taring.take(window, before_n, settled, has_common=not self._tared_ns)
        if found is None:
            return
        if found.touched is not None:
            self._refuse(taxels.surface.name_of(found.touched))
            return
        if region is None and not self._is_own:
            region = np.ones(taxels.count, np.bool_)
        if region is not None:
            self._settle(found.mean_n, found.known, region)
            return
        self._noise.learn_bias()
        known, level_n = found.known, found.level_n - self._noise.bias_n
        slope_n = found.slope_n if self._tares else np.zeros_like(level_n)  # nothing follows the drift then
        support = ZeroSupport.TOLD if self._taring.forced else ZeroSupport.MEASURED
        level_n = np.where(known, level_n, 0.0)
        measured = Measured(level_n, slope_n, known, support, self._newest_ns, TARE_WINDOWS, found.noise_n)
        self._use(self._new_zero(measured))
        later = f"when nothing has touched them for {self.tare_s:.3g} s" if self._tares else "at the next 'skin tare'"
        late = "" if known.all() else f"; the others get theirs {later}"
        self._end(
            f"zero of {int(known.sum())} of {known.size} sums: offsets {1e3 * rms(level_n[known]):.2f} mN rms,"
            f" up to {1e3 * float(np.abs(level_n[known]).max()):.2f} mN; noise {1e3 * self._noise.noise_n:.2f} mN{late}"
        )

    def _settle(self, mean_n: Floats, known: Bools, region: Bools) -> None:
        """Take what stands in a part of the skin for its zero."""
        if self._followed is None:
            self._taring.begin()
            self._tell(is_done=False, text="the skin has no zero yet: measure that of all of the skin first")
            return
        known = known & self._usable
        way_n = self._followed.settle(mean_n - self._noise.bias_n, known, region, self._newest_ns)
        self._followed.centre_ns = self._newest_ns
        self._end(f"zero of {int(region.sum())} taxels: moved by up to {1e3 * way_n:.2f} mN")

    def _end(self, text: str) -> None:
        """End a measurement of the zero that has succeeded."""
        self._taring.begin()
        self._tared_ns = self._newest_ns
        self.revision += 1
        self.state = CalibrationState.FOLLOWING if self._tares else CalibrationState.LOADED
        self._tell(is_done=True, text=text)

    def _refuse(self, where: str) -> None:
        """Keep the zero there is; a skin that measures its zero by itself and has none tries again."""
        touched = f"something touches the skin or moves on it, around {where}"
        if self._tares and not self._tared_ns and self._is_own:
            if self.state is not CalibrationState.TOUCHED:
                self.state = CalibrationState.TOUCHED
                wanted = f"its zero is measured when it has been untouched for {self.tare_s:.3g} s"
                self._tell(is_done=False, text=f"{touched}: {wanted}")
            return
        has_zero = self._followed is not None and (self._is_own or self._tared_ns)
        unasked = CalibrationState.LOADED if has_zero else CalibrationState.OFF
        self.state = CalibrationState.FOLLOWING if self._tares else unasked
        self._taring.begin()
        self._tell(is_done=False, text=f"{touched}: the zero stays as it was")

    def _tell(self, *, is_done: bool, text: str) -> None:
        self.result = TareResult(is_done, text)
        self._say(text)

    def _drop(self) -> None:
        """Go on without a zero; where the boards take theirs off, with a zero of 0."""
        if self._is_own:
            self._use(None)
            return
        zeros = np.zeros(self._phi.shape[0])
        self._use(self._new_zero(Measured(zeros, zeros, zeros == 0, ZeroSupport.STORED, self._newest_ns, age=1)))
        if self._tares:
            self.state = CalibrationState.FOLLOWING

    def _use(self, followed: FollowedZero | None) -> None:
        """Go on with another zero."""
        self._followed = followed
        self._corrections.take(followed, tares=self._tares)
