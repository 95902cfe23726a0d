"""The zero of every sum of a skin, and what forces below it and above it say of it.

The sums y of a window are Φ (f + d) + u: forces f, which are never below 0; a field d of offsets that neighbouring
taxels share; and the rest u, offsets that have no pattern on the skin. With the zero z, `calibration.field` finds the
field x of y - z.

* x < 0 cannot be a force: z moves by Φ x, at once and there alone. While something touches, x has to stay below 0 for
  `PROOF_WINDOWS` windows, and below a part of the largest force.
* x > 0 is a touch. z never follows it.
* u is followed (`calibration.drift`) in blocks that nothing touches. A touch that grows too slowly to be seen in one
  window is seen in the way that z has gone since its anchor, and is given back.
* Of a zero that the boards follow themselves nothing is followed here: what a person has settled can fall again.
* A fall of a measured zero may come back: z takes forces above 0 back slowly up to what fell before, and at once what
  fell while something touched.
"""

from typing import Final

import numpy as np

from calibration.drift import DriftFollower
from calibration.falls import PROOF_WINDOWS, Falls
from calibration.field import Field, FieldFinder
from calibration.late_blocks import LateBlocks
from calibration.still_touch import StillTouch
from calibration.taring import FLOOR_PART
from calibration.windows import Bools, Floats, Window
from canskin.calibration_messages import ZeroSupport
from skin.phi import Sbhe
from skin.surface import Surface

#: While something touches, forces below 0 count beyond this part of the largest force: images of a touch err by less.
LEAST_PART: Final = 0.05
#: Windows from audit to audit, and part of the way of the zero by which its anchor follows in each.
AUDIT_WINDOWS: Final = 4
ANCHOR_GAIN: Final = 0.0005
#: Noise of an offset over that of a window: a line through ten seconds.
LEAST_AUDIT: Final = 0.3
#: What all taxels have in common is followed while it rises by less than this part of what is seen in a window:
#: temperature. What rises faster is a press of all of the skin. Of a stored zero it is followed however large.
SLOW_RATIO: Final = 1.5
#: The zero of all taxels has fallen when this part of those that were untouched, at least `LEAST_REST` of all, is low.
FALLEN_PART: Final = 0.85
LEAST_REST: Final = 0.1
#: Low is below this part of the noise of the picture: the field of noise alone is a little below 0, too.
FALLEN_RATIO: Final = 0.5
#: What is left is sudden from this ratio to the noise on, and of one sign from this ratio of the signs on.
SUDDEN_RATIO: Final = 5.0
ONE_SIGN_RATIO: Final = 3.0
#: Taxels at most this many edges from a touch count as touched, too.
MARGIN: Final = 2


class Zero:
    """The zero of a skin from window to window.

    Parameters
    ----------
    references : array of bool, shape (n,)
        Taxels that nothing can touch.
    follower : DriftFollower
        With the first offsets.
    support : ZeroSupport
        Of the first offsets: what falls below measured ones may come back.
    follows : bool
        False where the boards follow their zero: then it falls no further than it was moved up, and does not drift.

    Attributes
    ----------
    follower : DriftFollower
    force_n : array, shape (n,)
        What stands above the zero in the newest window, newtons.
    touched : array of bool, shape (n,)
        Where that is seen beyond noise.
    held : array of bool, shape (blocks,)
        Blocks whose zero is not followed.
    moved_n : array, shape (n,)
        Field by which the zero was moved in the newest window besides its drift, newtons.
    fallen : array of bool, shape (n,)
        Taxels whose zero was corrected in the newest window by forces below it.
    calm_windows : int
        Windows in a row in which sums came and nothing touched or fell.
    needs_audit : bool
        Whether `audit` is due.
    """

    def __init__(
        self,
        phi: Sbhe,
        surface: Surface,
        finder: FieldFinder,
        follower: DriftFollower,
        *,
        support: ZeroSupport,
        references: Bools,
        follows: bool = True,
    ) -> None:
        taxels = phi.shape[1]
        self.follower = follower
        self.force_n, self.touched = np.zeros(taxels), np.zeros(taxels, np.bool_)
        self._near = self.touched
        self.held = np.zeros(phi.blocks, np.bool_)
        self.moved_n, self.fallen = np.zeros(taxels), np.zeros(taxels, np.bool_)
        self._phi, self._finder, self._surface = phi, finder, surface
        self._is_stored, self._follows, self._references = support is ZeroSupport.STORED, follows, references
        #: How far the zero of each taxel may fall, newtons.
        self._room_n = np.full(taxels, np.inf if follows else 0.0)
        self._below_n = np.zeros((PROOF_WINDOWS, taxels))
        self._anchor_n = follower.level_n.copy()
        self._falls = Falls(taxels, is_credited=support is ZeroSupport.MEASURED)
        self._still, self._late = StillTouch(phi), LateBlocks(phi)
        self._windows = self.calm_windows = 0
        self.needs_audit = False

    def skip(self, windows: int) -> None:
        """Let the zero go on for windows in which nothing was measured."""
        self.follower.skip(windows)
        self._below_n[:] = 0
        self._still.end()
        self._late.skip()

    def take(self, window: Window, usable: Bools) -> None:
        """Look at the next window; only `usable` sums, shape (m,), tell anything."""
        self._take(window, usable)
        came = self._phi.all_of_blocks(self.follower.known & window.known) & self._phi.has_sums
        is_calm = came.any() and not self.touched.any() and not self.fallen.any()
        self.calm_windows = self.calm_windows + 1 if is_calm else 0

    def _take(self, window: Window, usable: Bools) -> None:
        follower = self.follower
        known = window.known & follower.known & usable
        self.moved_n, self.fallen = np.zeros_like(self.force_n), np.zeros_like(self.touched)
        left_n = np.where(known, window.mean_n - follower.predicted_n(1.0), 0.0)
        field = self._find(left_n, known)
        least_n = self._finder.least_n(field.noise_n)
        force_n = field.force_n
        common_n = self._common(force_n, known) if self._follows else 0.0
        if common_n:
            self.move(np.full_like(force_n, common_n))
            force_n = force_n - common_n
        self._look(force_n, least_n)
        if not self.touched.any():  # under a touch a shift may be what its field leaves
            follower.move(field.shift_n)
            self._anchor_n += field.shift_n
        self._is_stored &= bool(self.touched.any()) or not known.any()
        self._take_off(least_n)
        if not self._follows:
            return
        if self.touched.any():  # only what has no pattern is followed
            pattern_n = self._finder.sums(field.force_n - self.moved_n)
            follower.take(window.mean_n - pattern_n, window.known, self.held)
            if self._still.is_known:
                drift_n = self._still.drift_n(left_n, self._finder.sums(field.force_n - self._still.force_n))
                follower.add(np.where(known & self.held[self._phi.block_of_sum], drift_n, 0.0))
        else:
            follower.take(window.mean_n, window.known, self.held)
        begun = self._late.take(window, follower.known, self.held)
        if begun is not None:
            follower.begin(*begun)
            self._anchor_n = np.where(begun.sums, begun.level_n, self._anchor_n)
        self._windows += 1
        self.needs_audit |= self._windows % AUDIT_WINDOWS == 0

    def settle(self, mean_n: Floats, known: Bools, region: Bools) -> Floats:
        """Take what stands on the taxels of `region`, shape (n,), for zero.

        Parameters
        ----------
        mean_n : array, shape (m,)
            Of raw sums, newtons.
        known : array of bool, shape (m,)
            Sums that have a mean.

        Returns
        -------
        array, shape (n,)
            Field by which the zero has moved, newtons.
        """
        used = known & self.follower.known
        left_n = np.where(used, mean_n - self.follower.level_n, 0.0)
        field = self._finder.find(left_n, used, self.follower.noise_n)
        settled_n = np.where(region, np.maximum(field.force_n, -self._room_n), 0.0)
        self.move(settled_n)
        self._falls.settle(region)
        self.force_n = np.where(region, 0.0, self.force_n)
        return settled_n

    def _common(self, force_n: Floats, known: Bools) -> float:
        """Return by how much the zero of all taxels has risen slowly, or fallen, newtons; touches keep their force.

        References that were measured and agree tell how much at any speed. A fall below noise is left to drift.
        """
        least_n = self._finder.least_n(self.follower.noise_n)
        measured = self._references & self._phi.of_taxels(self._phi.all_of_blocks(known))
        if measured.any():
            low_n, middle_n, high_n = np.quantile(force_n[measured], (0.25, 0.5, 0.75))
            if high_n - low_n < least_n:
                return float(middle_n)
        rest_n = force_n[~self._near]
        fallen_n = float(np.quantile(rest_n, FALLEN_PART)) if rest_n.size > LEAST_REST * force_n.size else 0.0
        if fallen_n < -FALLEN_RATIO * self._finder.picture_gain * self.follower.noise_n:
            return fallen_n
        risen_n = float(np.quantile(force_n, FLOOR_PART))
        return risen_n if 0 < risen_n < (np.inf if self._is_stored else SLOW_RATIO * least_n) else 0.0

    def _look(self, force_n: Floats, least_n: float) -> None:
        """Note what is touched."""
        self.force_n = np.maximum(force_n, 0)
        self.touched = force_n > least_n
        self._near = self._surface.spread(self.touched, MARGIN if self.touched.any() else 0)
        self.held = np.zeros(self._phi.blocks, np.bool_)
        self.held[self._phi.blocks_of(self._near)] = True
        self._below_n = np.roll(self._below_n, 1, axis=0)
        self._below_n[0] = np.minimum(force_n, 0)

    def _take_off(self, least_n: float) -> None:
        """Correct the zero where forces are below it, and where they are those of a fall that has ended."""
        is_touched = bool(self.touched.any())
        proven_n = np.maximum(self._below_n.max(axis=0) if is_touched else self._below_n[0], -self._room_n)
        limit_n = max(least_n, LEAST_PART * float(self.force_n.max())) if is_touched else least_n
        fall_n = np.where(self._finder.opened(proven_n < -limit_n), proven_n, 0.0)
        if fall_n.any():
            self.move(fall_n)
            self.fallen = fall_n < 0
            self._below_n = np.minimum(self._below_n - fall_n, 0)
        back_n = self._falls.take(fall_n, self.force_n, least_n, is_touched=is_touched)
        if back_n.any():
            self.move(back_n)
            self.force_n = self.force_n - back_n

    def _find(self, left_n: Floats, known: Bools) -> Field:
        """Return the field of what is left of the sums.

        While a touch stands still, what its field does not explain of the sums is expected, and what changes is drift.
        """
        noise_n, still = self.follower.noise_n, self._still
        if still.is_known:
            field = self._finder.find(np.where(known, left_n - still.expected_n, 0.0), known, noise_n)
            if still.goes_on(field.force_n):
                return field._replace(force_n=still.force_n + field.force_n)
        field = self._of_one_sign(self._finder.find(left_n, known, noise_n), left_n, known)
        still.take(field.force_n, left_n)
        return field

    def _of_one_sign(self, field: Field, left_n: Floats, known: Bools) -> Field:
        """Return a field of what is left, or a sharp one of a touch with too fine a shape, such as a ring.

        Drift without a pattern has both signs. What is sudden and has one sign is a touch, or the end of one.
        """
        noise_n = self.follower.noise_n
        if self._is_stored or field.noise_n < SUDDEN_RATIO * noise_n:
            return field
        sharp = self._finder.find(left_n, known, noise_n, is_sharp=True)
        above_n, below_n = np.maximum(sharp.force_n, 0), np.minimum(sharp.force_n, 0)
        if above_n.sum() > -ONE_SIGN_RATIO * below_n.sum():
            return sharp._replace(force_n=above_n)
        if -below_n.sum() > ONE_SIGN_RATIO * above_n.sum():
            return sharp._replace(force_n=below_n)
        return field

    def audit(self) -> Floats:
        """Give back what the zero has followed that looks like a touch since its anchor.

        Returns
        -------
        array, shape (n,)
            Field by which the zero has moved, newtons.
        """
        follower, self.needs_audit = self.follower, False
        way_n = follower.level_n - self._anchor_n
        field = self._finder.find(way_n, follower.known, LEAST_AUDIT * follower.noise_n)
        least_n = self._finder.least_n(field.noise_n)
        floor_n = max(0.0, float(np.quantile(field.force_n, FLOOR_PART)))
        risen_n = field.force_n - floor_n
        back_n = self._falls.returned_n(risen_n)
        touch_n = np.where(self._finder.opened(risen_n - back_n > least_n), risen_n - back_n, 0.0)
        fall_n = np.where(self._finder.opened(risen_n < -least_n), risen_n, 0.0)
        self._falls.audit(back_n, fall_n)
        self._anchor_n += self._finder.sums(floor_n + back_n + fall_n)
        if touch_n.any():
            follower.move(-self._finder.sums(touch_n))
        self._anchor_n += ANCHOR_GAIN * (follower.level_n - self._anchor_n)
        # What neighbouring taxels share has no slope: when its drift ends, the zero would run on.
        slope = self._finder.find(follower.slope_n, follower.known, 0.0)
        shared_n = slope.force_n - np.median(slope.force_n)
        seen = self._finder.opened(np.abs(shared_n) > self._finder.least_n(slope.noise_n))
        follower.turn(-self._finder.sums(np.where(seen, shared_n, 0.0)))
        return -touch_n

    def move(self, change_n: Floats) -> None:
        """Move the zero by a field that is proven, shape (n,), newtons."""
        sums_n = self._finder.sums(change_n)
        self.follower.move(sums_n)
        self._anchor_n += sums_n
        self.moved_n += change_n
        self._room_n += change_n
