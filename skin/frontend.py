"""The analogue front end: the currents of a block's taxels are added before one converter for each sum.

    y_k = g⁺_k Σ⁺ x(t_k) - g⁻_k Σ⁻ x(t_k) + o_k + n_k = D_k H_k x(t_k) + C_k H_0 x(t_k) + o_k + n_k

Σ⁺ and Σ⁻ add the taxels with the signs + and - in the Hadamard row H_k, and H_0 adds all taxels of the block. No taxel
is clipped. The gains g differ between the paths (`skin.defects.SumGains`), o is an offset, n the noise behind the
addition. The rows of a block are read one after the other: t_k is SYNC + the place of the row x skew.

The converter of a sum has `adc_bits` and two's complement. One step is B counts of a taxel, so the converter spans
± B / 2 times the largest force: a sum of signs + and - fits. The row of all ones saturates where the mean force of the
block is above half of the range. A sum with one of the two end codes is saturated.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from skin.defects import Defects, Force, Stage, SumGains
from skin.layout import Layout
from skin.phi import Sbhe

#: A taxel or sum that feels less than this part is defective: no gain of the taxel is stored, and the sum is not used.
LEAST_FELT: Final = 0.3


@dataclass(frozen=True)
class SumConverter:
    """The converter of one analogue sum.

    Attributes
    ----------
    step_counts : int
        One step in counts of a taxel.
    low, high : int
        The end codes.
    newton_per_count : float
    """

    step_counts: int
    low: int
    high: int
    newton_per_count: float

    def codes(self, counts: npt.NDArray[np.floating]) -> npt.NDArray[np.int32]:
        """Return the codes of sums in counts of a taxel, rounded, limited to the range; same shape."""
        codes: npt.NDArray[np.int32] = np.clip(np.rint(counts / self.step_counts), self.low, self.high).astype(np.int32)
        return codes

    def rounded(self, counts: npt.NDArray[np.floating]) -> npt.NDArray[np.int32]:
        """Return what sums in counts of a taxel read, in the same unit; same shape."""
        return self.codes(counts) * np.int32(self.step_counts)

    def counts(self, sums_n: npt.NDArray[np.floating]) -> npt.NDArray[np.int32]:
        """Return what sums in newtons read, in counts of a taxel; same shape."""
        return self.rounded(sums_n / self.newton_per_count)

    def is_saturated(self, counts: npt.NDArray[np.int32]) -> npt.NDArray[np.bool_]:
        """Tell which sums, in counts of a taxel, have an end code; same shape."""
        codes = counts // self.step_counts
        saturated: npt.NDArray[np.bool_] = (codes <= self.low) | (codes >= self.high)
        return saturated


def converter(layout: Layout) -> SumConverter | None:
    """Return the converter of a sum; None where the front end is digital."""
    taxels = layout.taxels
    if not taxels.is_analogue:
        return None
    half = 1 << taxels.adc_bits - 1
    return SumConverter(layout.measurement.block_size, -half, half - 1, taxels.newton_per_count)


def sum_step_n(layout: Layout) -> float:
    """Return the step of a sum before it is packed, newtons: one count, or one step of its converter.

    Of steps their unit.
    """
    if layout.sends.sum_bits is not None:
        return layout.measurement.block_size * layout.taxels.force_max_n / (1 << layout.sends.sum_bits)
    of_sums = converter(layout)
    return layout.taxels.newton_per_count * (1 if of_sums is None else of_sums.step_counts)


class SumModel:
    """The analogue front end of a skin with its defects, those of sums.

    Attributes
    ----------
    gains : SumGains or None
        None: the gains of all paths are 1.
    row_times_s : array of float32, shape (m,), or None
        When each sum is read after SYNC; None: all at SYNC.
    """

    def __init__(self, phi: Sbhe, defects: Defects) -> None:
        sums = phi.shape[:1]
        gains, times_s, offsets_n, noises_n = (
            defects.effects(stage, sums)
            for stage in (Stage.SUM_PATHS, Stage.SUM_TIME, Stage.SUM_OFFSET, Stage.SUM_NOISE)
        )
        self.gains: SumGains | None = gains[0] if gains else None
        place = np.arange(sums[0]) - phi.starts[phi.block_of_sum]
        self.row_times_s: Force | None = (place * times_s[0]).astype(np.float32) if times_s else None
        self._phi, self._offsets_n, self._noises_n, self._drifts = phi, offsets_n, noises_n, defects.sum_drifts

    def sums_n(
        self,
        signal_n: Force,
        rng: np.random.Generator,
        *,
        change_n_per_s: Force | None = None,
        time_s: float = 0.0,
    ) -> Force:
        """Return what the converters get.

        Parameters
        ----------
        signal_n : array of float32, shape (..., n)
            Forces of the taxels at SYNC, noise included, newtons.
        rng : numpy.random.Generator
            Source of the noise of sums.
        change_n_per_s : array of float32, shape (..., n), optional
            How fast the forces change after SYNC; skew needs it.
        time_s : float
            Time of the SYNC; drifts need it.

        Returns
        -------
        array of float32, shape (..., m)
        """
        sums_n = self._added(signal_n)
        if self.row_times_s is not None and change_n_per_s is not None:
            sums_n += self._added(change_n_per_s) * self.row_times_s
        for offset_n in self._offsets_n:
            sums_n += offset_n
        for drift in self._drifts:
            sums_n += drift.offsets_n(sums_n.shape[-1:], np.array([time_s]))[0]
        for noise_n in self._noises_n:
            sums_n += np.float32(noise_n) * rng.standard_normal(sums_n.shape, np.float32)
        return sums_n

    def _added(self, force_n: Force) -> Force:
        sums_n: Force = np.asarray(self._phi.forward(force_n), np.float32)
        return sums_n if self.gains is None else with_gains(self._phi, force_n, sums_n, self.gains)


def with_gains(phi: Sbhe, force_n: Force, sums_n: Force, gains: SumGains) -> Force:
    """Return the sums of two paths with gains, float32 of shape (..., m), of forces and their exact sums."""
    differential, common_mode = (each.astype(np.float32) for each in gains)
    total_n = phi.padded(force_n)[..., phi.taxels_of_blocks].sum(axis=-1, dtype=np.float32)[..., phi.block_of_sum]
    made: Force = differential * sums_n + common_mode * total_n
    return made


def felt_by_sums(phi: Sbhe, gains: SumGains) -> npt.NDArray[np.float64]:
    """Return which part of its signal each sum feels, shape (m,).

    This is D, or D + C in the row of all ones, which has one path.

    """
    return gains.differential + np.where(phi.row_of_sum == 0, gains.common_mode, 0.0)
