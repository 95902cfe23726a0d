"""The analogue front end: the currents of a block's taxels are added before one converter for each sum.

    y_k = g⁺_k Σ⁺ x(t_k) - g⁻_k Σ⁻ x(t_k) + o_k + n_k = D_k H_k x(t_k) + C_k H_0 x(t_k) + o_k + n_k

Σ⁺ and Σ⁻ add the taxels with the signs + and - in the Hadamard row H_k, and H_0 adds all taxels of the block. No taxel
is clipped. The gains g differ between the paths (`skin.defects.SumGains`), o is an offset, n the noise behind the
addition. The rows of a block are read one after the other: t_k is SYNC + the place of the row x `Skew.row_s`.

The converter of a sum has `adc_bits` and two's complement. One step is B counts of a taxel, so the converter spans
± B / 2 times the largest force: a sum of signs + and - fits. The row of all ones saturates where the mean force of the
block is above half of the range. A sum with one of the two end codes is saturated.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from skin.defects import Force, Mismatch, Skew, SumGains, SumNoise, SumOffset
from skin.layout import Layout
from skin.measurement import Sbhe
from skin.zero_drift import ZeroDrift

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

    Of adaptive sums the coarse step near 0.
    """
    if layout.sends.coarse_step_ratio is not None:
        return layout.sends.coarse_step_ratio * layout.taxels.force_max_n
    of_sums = converter(layout)
    return layout.taxels.newton_per_count * (1 if of_sums is None else of_sums.step_counts)


@dataclass(frozen=True)
class SumModel:
    """Gains, offset, noise, skew and drifts of the sums of one skin; without them a perfect front end."""

    mismatch: Mismatch | None = None
    sum_offset: SumOffset | None = None
    sum_noise: SumNoise | None = None
    skew: Skew | None = None
    sum_drifts: tuple[ZeroDrift, ...] = ()

    def sums_n(
        self,
        phi: Sbhe,
        signal_n: Force,
        rng: np.random.Generator,
        *,
        change_n_per_s: Force | None = None,
        time_s: float = 0.0,
    ) -> Force:
        """Return what the converters get.

        Parameters
        ----------
        phi : Sbhe
        signal_n : array of float32, shape (..., n)
            Forces of the taxels at SYNC, noise included, newtons.
        rng : numpy.random.Generator
            Source of the noise of sums.
        change_n_per_s : array of float32, shape (..., n), optional
            How fast the forces change after SYNC; `skew` needs it.
        time_s : float
            Time of the SYNC; drifts need it.

        Returns
        -------
        array of float32, shape (..., m)
        """
        sums_n = self._added(phi, signal_n)
        if self.skew is not None and change_n_per_s is not None:
            sums_n += self._added(phi, change_n_per_s) * row_times_s(phi, self.skew)
        if self.sum_offset is not None:
            sums_n += self.sum_offset.offsets_n(phi.shape[0])
        for drift in self.sum_drifts:
            sums_n += drift.offsets_n(phi.shape[:1], np.array([time_s]))[0]
        if self.sum_noise is not None:
            noise = rng.standard_normal(sums_n.shape, np.float32)
            sums_n += np.float32(self.sum_noise.deviation_n) * noise
        return sums_n

    def _added(self, phi: Sbhe, force_n: Force) -> Force:
        sums_n: Force = np.asarray(phi.forward(force_n), np.float32)
        if self.mismatch is None:
            return sums_n
        return with_gains(phi, force_n, sums_n, self.mismatch.gains(phi.shape[0]))


def with_gains(phi: Sbhe, force_n: Force, sums_n: Force, gains: SumGains) -> Force:
    """Return the sums of two paths with gains, float32 of shape (..., m), of forces and their exact sums."""
    differential, common_mode = (each.astype(np.float32) for each in gains)
    total_n = force_n[..., phi.taxels_of_blocks].sum(axis=-1, dtype=np.float32)[..., phi.block_of_sum]
    made: Force = differential * sums_n + common_mode * total_n
    return made


def row_times_s(phi: Sbhe, skew: Skew) -> Force:
    """Return when each sum is read after SYNC, float32, shape (m,)."""
    place = np.arange(phi.shape[0]) - phi.starts[phi.block_of_sum]
    return (place * skew.row_s).astype(np.float32)


def felt_by_sums(phi: Sbhe, gains: SumGains) -> npt.NDArray[np.float64]:
    """Return which part of its signal each sum feels, shape (m,).

    This is D, or D + C in the row of all ones, which has one path.

    Parameters
    ----------
    phi : Sbhe
    gains : SumGains
    """
    return gains.differential + np.where(phi.row_of_sum == 0, gains.common_mode, 0.0)
