"""Conversion of a sum of ADC counts to an integer of a few bits: width, scale and offset.

The scale is the smallest power of two with which no sum can saturate, for any Hadamard row: with B taxels of 0 to c
counts, a balanced row spans -B c / 2 to B c / 2, and the row of all ones 0 to B c. An analogue sum spans the range of
its converter, and the scale is the converter's step or a multiple of it.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from skin.frontend import SumConverter, converter
from skin.layout import Layout

#: Bytes before the sums of a frame: the SYNC counter of their cycle.
COUNTER_BYTES: Final = 1


@dataclass(frozen=True)
class Packing:
    """Width and meaning of the raw value of a sum: ``counts = (raw - offset) * scale``.

    Attributes
    ----------
    bits : int
        Width in a PDO: 7 to 16.
    scale : int
        Counts per step, a power of two; 1 is exact.
    offset : int
        0: raw values are two's complement. Else raw values are unsigned, and a sum of 0 has the raw value `offset`:
        alternating bits, which need no stuff bits. `offset` divides the range 1:2, like 0 the range of the sums.
    converter : SumConverter, optional
        Of analogue sums.
    """

    bits: int
    scale: int
    offset: int
    converter: SumConverter | None = None

    @property
    def is_signed(self) -> bool:
        """Whether raw values are two's complement."""
        return self.offset == 0

    @property
    def raw_range(self) -> tuple[int, int]:
        """Lowest and highest raw value of this width."""
        low = -(1 << self.bits - 1) if self.is_signed else 0
        return low, low + (1 << self.bits) - 1

    @property
    def rounding_counts(self) -> int:
        """Largest rounding error of a sum, in counts."""
        return self.scale // 2

    def raw(self, sums: npt.NDArray[np.integer]) -> npt.NDArray[np.int32]:
        """Return the raw values of `sums` in counts; halves are rounded towards 0.

        The error is that of any other rounding of halves. With this rounding, 12-bit sums of 32 taxels of 12 bits need
        half the scale only: the sum of all taxels at full scale is 2047.5 steps.
        """
        counts = sums.astype(np.int32)
        if self.scale > 1:
            step = self.scale.bit_length() - 1
            counts = (counts + self.scale // 2 - (counts > 0)) >> step
        raw = counts + np.int32(self.offset)
        # The highest codes of a converter may round to more than there is; they are saturated either way.
        return raw if self.converter is None else np.minimum(raw, np.int32(self.raw_range[1]))

    def usable(self, sums: npt.NDArray[np.int32]) -> bytes:
        """Return `Measurement.usable` of decoded sums: uint8, shape (m,), 0 if saturated; empty if none is."""
        if self.converter is None:
            return b""
        ends = np.array([self.converter.low, self.converter.high], np.int32) * np.int32(self.converter.step_counts)
        low, high = self.counts(self.raw(ends))
        usable = (sums > low) & (sums < high)
        return b"" if usable.all() else usable.astype(np.uint8).tobytes()

    def counts(self, raw: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
        """Return the sums in counts of `raw` values."""
        return (raw - np.int32(self.offset)) * np.int32(self.scale)


def packing(layout: Layout) -> Packing:
    """Return the packing of a skin's sums."""
    bits = layout.encoding.sum_bits
    offset = ((1 << bits) - 1) // 3 if layout.encoding.offset_binary else 0
    size, top = layout.measurement.block_size, (1 << layout.taxels.adc_bits) - 1
    of_sums = converter(layout)
    scale, low, high = 1, -(size // 2) * top, size * top
    if of_sums is not None:
        scale, low, high = of_sums.step_counts, of_sums.low * of_sums.step_counts, of_sums.high * of_sums.step_counts
    while not _holds(Packing(bits, scale, offset), low, high - (0 if of_sums is None else scale // 2)):
        scale *= 2
    return Packing(bits, scale, offset, of_sums)


def rounding_error_n(layout: Layout) -> float:
    """Return the largest rounding error of a sum in newtons; 0 if the packing is exact."""
    return packing(layout).rounding_counts * layout.taxels.newton_per_count


def _holds(tried: Packing, lowest: int, highest: int) -> bool:
    low, high = tried.raw_range
    raw = tried.raw(np.array([lowest, highest]))
    return low <= int(raw[0]) and int(raw[1]) <= high
