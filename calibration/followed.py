"""A zero in use: followed from window to window, with its doubt, its support, and what temperature tells of it."""

from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from calibration.doubt import Doubt
from calibration.drift import DriftFollower
from calibration.field import FieldFinder
from calibration.temperature import TemperatureModel
from calibration.windows import TARE_WINDOWS, Bools, Floats, Window
from calibration.zero import Zero
from canskin.calibration_messages import ZeroSupport
from skin.frontend import sum_step_n
from skin.layout import Layout
from skin.phi import Sbhe
from skin.surface import Surface

#: No noise is taken to be less than this part of a count: sums are whole numbers of counts.
LEAST_STEP: Final = 0.3
#: What boards that send steps leave unsent of a still sum, as part of a taxel's full scale: more than a unit.
_UNSENT_RATIO: Final = 1 / 40
#: Windows without touch after which a skin supports its zero.
CALM_WINDOWS: Final = TARE_WINDOWS
#: Least correction below zero that is logged, as part of the range, and least time between two such lines.
LOGGED_RATIO: Final = 0.01
LOGGED_NS: Final = 10_000_000_000


def least_noise_n(layout: Layout) -> float:
    """Return the least noise of a sum, newtons."""
    unsent_n = 0.0 if layout.sends.in_cycles else _UNSENT_RATIO * layout.taxels.force_max_n
    return LEAST_STEP * max(sum_step_n(layout), unsent_n)


class Support:
    """How the zero of each block is supported, and since when.

    Parameters
    ----------
    known : array of bool, shape (m,)
        Sums that have a zero.
    support : ZeroSupport
        Of their blocks.
    boards_keep_zero : bool
        Boards that have not sent yet have no known zero.

    Attributes
    ----------
    of_blocks : array of uint8, shape (blocks,)
        `ZeroSupport`.
    since_ns : array of int64, shape (blocks,)
        When the zero was last measured or told; 0 for never.
    """

    def __init__(
        self, phi: Sbhe, known: Bools, support: ZeroSupport, time_ns: int, *, boards_keep_zero: bool = False
    ) -> None:
        self._phi = phi
        whole = self._whole(known)
        self._boards_keep_zero = boards_keep_zero
        begun = ZeroSupport.NONE if boards_keep_zero else support
        self.of_blocks = np.where(whole, begun, ZeroSupport.NONE).astype(np.uint8)
        self.since_ns: npt.NDArray[np.int64] = np.where(whole & (support > ZeroSupport.STORED), time_ns, 0)

    def tell(self, taxels: Bools, time_ns: int) -> None:
        """Note a person's word on some taxels, shape (n,)."""
        blocks = self._phi.blocks_of(taxels)
        self.of_blocks[blocks], self.since_ns[blocks] = ZeroSupport.TOLD, time_ns

    def take(self, zero: Zero, window: Window) -> None:
        """Look at the zero after a window, in the blocks that came. A person's word counts until the zero falls."""
        came = self._whole(zero.follower.known & window.known)
        if self._boards_keep_zero:
            self.of_blocks[came & (self.of_blocks == ZeroSupport.NONE)] = ZeroSupport.STORED
        fallen = self._phi.blocks_of(zero.fallen)
        self.of_blocks[fallen[came[fallen]]] = ZeroSupport.CORRECTED
        if zero.calm_windows >= CALM_WINDOWS:
            self.of_blocks[came & (self.of_blocks != ZeroSupport.TOLD)] = ZeroSupport.MEASURED
        self.since_ns[came & ~zero.held & (self.of_blocks == ZeroSupport.MEASURED)] = window.centre_ns

    def _whole(self, known: Bools) -> Bools:
        return np.asarray(self._phi.all_of_blocks(known) & self._phi.has_sums, np.bool_)


class Measured(NamedTuple):
    """What a zero begins with.

    Attributes
    ----------
    level_n, slope_n : array, shape (m,)
        Offsets in newtons, and their change in a window.
    known : array of bool, shape (m,)
        Sums that have an offset.
    support : ZeroSupport
        Of the offsets.
    time_ns : int
        Centre of the window that measured or told offsets are of.
    age, noise_n
        See `DriftFollower`.
    """

    level_n: Floats
    slope_n: Floats
    known: Bools
    support: ZeroSupport
    time_ns: int
    age: int = 0
    noise_n: float = 0.0


class FollowedZero:
    """A zero in use.

    Parameters
    ----------
    temperature : TemperatureModel
        It is kept from zero to zero.
    length_ns : int
        Of a window.

    Attributes
    ----------
    zero : Zero
    doubt : Doubt
    support : Support
    centre_ns : int
        Centre of the window that the offsets are of, 0 if they are of another time.
    was_doubtful : bool
        Whether a force was doubtful before the newest window.
    """

    def __init__(
        self, layout: Layout, finder: FieldFinder, temperature: TemperatureModel, length_ns: int, measured: Measured
    ) -> None:
        taxels, phi, keeps = layout.taxels, finder.phi, layout.sends.boards_keep_zero
        known, support = measured.known, measured.support
        follower = DriftFollower(
            phi.block_of_sum,
            phi.blocks,
            measured.level_n,
            measured.slope_n,
            known,
            age=measured.age,
            noise_n=measured.noise_n,
            least_noise_n=least_noise_n(layout),
        )
        self.zero = Zero(
            phi,
            taxels.surface,
            finder,
            follower,
            support=support,
            references=np.isin(np.arange(taxels.count), taxels.untouchable or ()),
            follows=not keeps,
        )
        self.doubt = Doubt(taxels.count, taxels.force_max_n, length_ns * 1e-9)
        self.support = Support(phi, known, support, measured.time_ns, boards_keep_zero=keeps)
        self.centre_ns = measured.time_ns if support > ZeroSupport.STORED else 0
        self.was_doubtful = False
        self._phi, self._length_ns = phi, length_ns
        self._temperature = temperature
        temperature.restart()
        #: The first offset of each sum, NaN for unknown ones.
        self._first_n = self.offsets_n

    @property
    def offsets_n(self) -> Floats:
        """Offsets of the sums in newtons, shape (m,), NaN for unknown ones."""
        follower = self.zero.follower
        return np.where(follower.known, follower.level_n, np.nan)

    def offsets_at_n(self, time_ns: int) -> Floats:
        """Return the offsets of the sums at a time, newtons, shape (m,)."""
        ahead = (time_ns - self.centre_ns) / self._length_ns if self.centre_ns else 0.0
        return self.zero.follower.predicted_n(ahead)

    def take(self, window: Window, usable: Bools) -> None:
        """Follow the zero, and doubt what stands on the skin; only `usable` sums, shape (m,), tell anything."""
        zero = self.zero
        skipped = round((window.centre_ns - self.centre_ns) / self._length_ns) - 1 if self.centre_ns else 0
        if skipped > 0:
            zero.skip(skipped)
        zero.take(window, usable)
        self.centre_ns = window.centre_ns
        self.doubt.move(zero.moved_n)
        self.was_doubtful = bool(self.doubt.since_ns)
        self.doubt.take(zero.force_n, window.centre_ns)
        self.support.take(zero, window)

    def forget(self, blocks: Bools) -> None:
        """Drop the offsets of some blocks, shape (blocks,): they begin anew as blocks that come late."""
        self.zero.follower.known &= ~self._phi.sums_of_blocks(blocks)
        self._first_n[~self.zero.follower.known] = np.nan
        self.support.of_blocks[blocks], self.support.since_ns[blocks] = ZeroSupport.NONE, 0

    def audit(self) -> None:
        """Give back what looks like a touch, if it is time for that."""
        if self.zero.needs_audit:
            self.doubt.move(self.zero.audit())

    def take_temperatures(self, kelvin: Floats) -> None:
        """Follow the temperatures of the boards, kelvin, shape (blocks,); NaN where unknown."""
        level_n, phi = self.offsets_n, self._phi
        self._first_n = np.where(np.isnan(self._first_n), level_n, self._first_n)  # blocks may come late
        totals = (phi.row_of_sum == 0) & self.zero.follower.known
        if not totals.any():
            return
        way_n = (level_n - self._first_n)[totals] / phi.block_size
        of_blocks = np.full(phi.blocks, np.nan)
        of_blocks[phi.block_of_sum[totals]] = way_n
        change_n = phi.of_taxels(self._temperature.take(kelvin, of_blocks))
        if change_n.any():
            self.zero.move(change_n)
            self.doubt.move(change_n)

    def settle(self, mean_n: Floats, known: Bools, region: Bools, time_ns: int) -> float:
        """Take what stands on the taxels of `region`, shape (n,), for zero; return the longest way, newtons.

        `mean_n` and `known` are those of `Zero.settle`.
        """
        moved_n = self.zero.settle(mean_n, known, region)
        self.doubt.move(moved_n)
        self.support.tell(region, time_ns)
        return float(np.abs(moved_n).max())


class ZeroLog:
    """Tells what was corrected, and what is doubtful.

    Parameters
    ----------
    say : callable
        Writes a line to the log.
    surface : Surface
        Of the skin.
    force_max_n : float
        End of the range.
    """

    def __init__(self, say: Callable[[str], None], surface: Surface, force_max_n: float) -> None:
        self._say, self._surface = say, surface
        self._least_n = LOGGED_RATIO * force_max_n
        self._told_ns = 0

    def tell(self, followed: FollowedZero) -> None:
        """Tell what the newest window has changed."""
        zero, doubt = followed.zero, followed.doubt
        fall_n = -float(zero.moved_n.min())
        if fall_n > self._least_n and followed.centre_ns > self._told_ns + LOGGED_NS:
            self._told_ns = followed.centre_ns
            self._say(f"forces of up to {1e3 * fall_n:.2g} mN a taxel below zero: the zero is corrected there")
        if doubt.since_ns and not followed.was_doubtful:
            where = self._surface.name_of(int(np.argmax(np.where(doubt.taxels, zero.force_n, 0))))
            self._say(
                f"a force around {where} stands still: a still weight, or the zero has risen there;"
                " marked as doubtful until it moves, ends, or 'skin tare --region' settles it"
            )
        elif followed.was_doubtful and not doubt.since_ns:
            self._say("no force is doubtful any more")
