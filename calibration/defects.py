"""Defects of a skin: sums that are stuck, saturated or noisy, blocks and taxels with another noise than the others.

Only sums come. A sum is stuck if it stays as it is while the others of its block change: every taxel is in all of them.
A noisy taxel shows in the differences d of consecutive cycles of its block: the mean of (w·d)², w the signs of the
taxel in the sums, is largest for this taxel. A taxel that is stuck or dead has no noise, which does not show among 31
others; `calibration.gains` finds it.

A block stands still if no sum of it changes any more, although its noise without touch is known, and is `least_n` or
more. A sum with a normal noise of 3 counts repeats its value with a probability below 0.1, and in all cycles of
`STUCK_WINDOWS`, 96 or more, with one below 1e-90. Blocks whose taxels may all be at an end of their range, where they
have no noise, do not count; nor do blocks that have stood still before, as where each frame of a recording stays long.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from calibration.windows import Bools, Floats, Window
from skin.phi import Sbhe
from skin.surface import Surface

#: A sum is stuck when it has not changed in `STUCK_WINDOWS` windows in which `STUCK_PART` of the others of its block
#: have, and saturated when it did not count in as many windows in which nothing touched its block.
STUCK_WINDOWS: Final = 12
STUCK_PART: Final = 0.75
#: A stretch of a block without change counts if it is this number of times longer than all before.
LONGER: Final = 4
#: Windows over which noise is averaged, and before which nothing is said of it.
MEMORY: Final = 40
#: Noise of a noisy sum over the median of all sums. Such sums are left out.
SUM_RATIO: Final = 4.0
#: Most noise, in medians of all sums, that one window counts for: a jump is no noise.
JUMP_RATIO: Final = 6.0
#: Noise of a noisy block over the median of all blocks, and the median over the noise of a quiet block.
LOUD_RATIO: Final = 1.75
QUIET_RATIO: Final = 3.0
#: Part of the loudest taxel in its block's noise over that of the second, from which on the taxel is named.
TAXEL_RATIO: Final = 1.25


@dataclass(frozen=True)
class Defects:
    """What was found.

    Attributes
    ----------
    usable : array of bool, shape (m,)
        False for sums that must be left out.
    words : list of str
        Each defect in words.
    """

    usable: Bools
    words: list[str] = field(default_factory=list)


class DefectFinder:
    """Finds defects from window to window.

    Parameters
    ----------
    surface : Surface
        Of the skin.
    least_n : float
        Noise of a sum that is no defect anyhow, newtons.
    say : callable
        Called with each defect that is new, in words.
    full_n : float
        End of the range of a taxel, newtons.

    Attributes
    ----------
    found : Defects
        In the newest window.
    stands_still : array of bool, shape (blocks,)
        Blocks whose sums do not change any more, although they have noise.
    """

    def __init__(self, phi: Sbhe, surface: Surface, least_n: float, say: Callable[[str], None], full_n: float) -> None:
        self._phi, self._surface, self._least_n, self._say = phi, surface, least_n, say
        self.found = Defects(np.ones(phi.shape[0], np.bool_))
        self._unchanged, self._saturated = np.zeros((2, phi.shape[0]), np.intp)
        self._windows = np.zeros(phi.blocks, np.intp)
        self._was_held = np.zeros(phi.blocks, np.bool_)
        self.stands_still = np.zeros(phi.blocks, np.bool_)
        #: Windows for which each block has stood still until now, and at most before.
        self._still, self._stillest = np.zeros((2, phi.blocks), np.intp)
        #: Sums of taxels that are all at the end of their range.
        self._full_n = np.asarray(phi.forward(np.full(phi.shape[1], full_n)), np.float64)
        self._square, self._power = np.zeros(phi.shape[0]), np.zeros(phi.shape[1])

    def take(self, window: Window, held: Bools) -> None:
        """Look at the next window.

        Parameters
        ----------
        held : array of bool, shape (blocks,)
            Blocks under a touch, whose changes are no noise.
        """
        phi = self._phi
        moves = (window.noise_n > 0) & window.known
        others = np.diff(phi.starts) - 1
        moving = phi.total_of_blocks(moves)[phi.block_of_sum] - moves
        tells = window.known & (others[phi.block_of_sum] > 0) & (moving >= STUCK_PART * others[phi.block_of_sum])
        self._unchanged = np.where(moves, 0, self._unchanged + tells)
        most_known = phi.total_of_blocks(window.known) >= STUCK_PART * np.diff(phi.starts)
        free = most_known & phi.has_sums & ~held & ~self._was_held  # a release falls into the window after
        self._was_held = held
        free &= ~self._stand(window, moves)
        self._saturated = np.where(free[phi.block_of_sum] & ~window.known, self._saturated + 1, 0)
        self._windows += free
        gain = (free / np.clip(self._windows, 1, MEMORY))[phi.block_of_sum] * window.known
        # One jump of a sum is no noise.
        usual_n = max(float(np.median(window.noise_n[window.known])) if window.known.any() else 0.0, self._least_n)
        self._square += gain * (np.minimum(window.noise_n, JUMP_RATIO * usual_n) ** 2 - self._square)
        part = np.asarray(phi.adjoint(np.where(window.known, window.difference_n, 0.0)), np.float64) ** 2
        gains = np.zeros(phi.wired.taxels)
        gains[phi.taxels_of_blocks] = (free / np.clip(self._windows, 1, MEMORY))[:, None]
        self._power += gains[: part.size] * (part - self._power)
        told = {_subject(each) for each in self.found.words}
        self.found = self._defects()
        for text in self.found.words:
            if _subject(text) not in told:
                self._say(text)

    def _stand(self, window: Window, moves: Bools) -> Bools:
        """Find the blocks that stand still; return those with noise that have not changed in this window."""
        phi = self._phi
        all_ends = [phi.all_of_blocks(np.abs(window.mean_n - end_n) < self._least_n) for end_n in (0.0, self._full_n)]
        is_still = phi.all_of_blocks(window.known & ~moves) & phi.has_sums & ~all_ends[0] & ~all_ends[1]
        self._stillest = np.where(is_still, self._stillest, np.maximum(self._stillest, self._still))
        self._still = np.where(is_still, self._still + 1, 0)
        has_noise = (self._windows >= MEMORY) & (self._noise_n() >= self._least_n)
        self.stands_still = has_noise & (self._still >= np.maximum(STUCK_WINDOWS, LONGER * self._stillest))
        unchanged: Bools = has_noise & is_still
        return unchanged

    def _noise_n(self) -> Floats:
        """Return the noise of the sums of each block without touch, shape (blocks,), newtons."""
        phi = self._phi
        noise_n: Floats = np.sqrt(phi.total_of_blocks(self._square) / np.maximum(np.diff(phi.starts), 1))
        return noise_n

    def _defects(self) -> Defects:
        phi = self._phi
        judged = self._windows >= MEMORY
        stuck = self._unchanged >= STUCK_WINDOWS
        saturated = self._saturated >= STUCK_WINDOWS
        noisy = np.zeros_like(stuck)
        words = [f"sum {self._name(each)} is stuck and left out" for each in np.flatnonzero(stuck).tolist()]
        words += [f"sum {self._name(each)} is saturated and left out" for each in np.flatnonzero(saturated).tolist()]
        of_block = self._noise_n()
        if judged.any():
            typical_n = float(np.median(of_block[judged]))
            is_quiet = judged & (typical_n > self._least_n) & (of_block < typical_n / QUIET_RATIO)
            typical_n = max(typical_n, self._least_n)
            noisy = judged[phi.block_of_sum] & (np.sqrt(self._square) > SUM_RATIO * typical_n)
            words += [f"sum {self._name(each)} is noisy and left out" for each in np.flatnonzero(noisy).tolist()]
            for block in np.flatnonzero(judged & (of_block > LOUD_RATIO * typical_n)).tolist():
                words.append(f"block {block} has {of_block[block] / typical_n:.1f} times the noise{self._taxel(block)}")
            words += [
                f"block {block} has less than 1/{QUIET_RATIO:g} of the noise: do its taxels measure?"
                for block in np.flatnonzero(is_quiet).tolist()
            ]
        return Defects(~(stuck | saturated | noisy), words)

    def _name(self, each: int) -> str:
        return f"{each} (block {self._phi.block_of_sum[each]}, row {self._phi.row_of_sum[each]})"

    def _taxel(self, block: int) -> str:
        """Name the taxel that a block's noise comes from, if it is one."""
        taxels = self._phi.taxels_of(block)
        if taxels.size == 1:
            return f" of {self._surface.name_of(int(taxels[0]))}"
        second, first = np.argsort(self._power[taxels])[-2:]
        power: Floats = self._power[taxels]
        if power[first] < TAXEL_RATIO * power[second]:
            return ""
        return f", most likely of {self._surface.name_of(int(taxels[first]))}"


def _subject(text: str) -> str:
    """Return what a defect is of: its first two words."""
    return " ".join(text.split()[:2])
