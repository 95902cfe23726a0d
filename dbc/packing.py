"""How one sum of ADC counts becomes an integer of a few bits: width, scale and offset.

The scale is the smallest power of two with which no sum can saturate, whichever Hadamard rows a block keeps: with B
taxels of at most c counts, a balanced row spans -B c / 2 to B c / 2 and the row of all ones 0 to B c.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from skin.layout import Layout


@dataclass(frozen=True)
class Packing:
    """Width and meaning of the raw value of a sum: ``counts = (raw - offset) * scale``.

    Attributes
    ----------
    bits : int
        Width in a PDO: 8, 12 or 16.
    scale : int
        Counts per step, a power of two; 1 is exact.
    offset : int
        0: raw values are two's complement. Else they are unsigned, and a sum of 0 is this pattern of alternating
        bits, which needs no stuff bits. It divides the range 1:2, as the sums' own range is divided.
    """

    bits: int
    scale: int
    offset: int

    @property
    def is_signed(self) -> bool:
        """Whether raw values are two's complement."""
        return self.offset == 0

    @property
    def raw_range(self) -> tuple[int, int]:
        """Lowest and highest raw value that the width holds."""
        low = -(1 << self.bits - 1) if self.is_signed else 0
        return low, low + (1 << self.bits) - 1

    @property
    def rounding_counts(self) -> int:
        """Largest difference between a sum and what arrives of it, in counts."""
        return self.scale // 2

    def raw(self, sums: npt.NDArray[np.integer]) -> npt.NDArray[np.int32]:
        """Return the raw values of `sums` in counts; halves are rounded towards 0.

        That is as near as any other rounding, and lets 12-bit sums of 32 taxels of 12 bits do with half the scale: the
        sum of all at full scale is 2047.5 steps.
        """
        counts = sums.astype(np.int32)
        if self.scale > 1:
            step = self.scale.bit_length() - 1
            counts = (counts + self.scale // 2 - (counts > 0)) >> step
        return counts + np.int32(self.offset)

    def counts(self, raw: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
        """Return the sums in counts that `raw` values stand for."""
        return (raw - np.int32(self.offset)) * np.int32(self.scale)


def packing(layout: Layout) -> Packing:
    """Return the packing of a skin's sums."""
    bits = layout.encoding.sum_bits
    offset = ((1 << bits) - 1) // 3 if layout.encoding.offset_binary else 0
    size, top = layout.measurement.block_size, (1 << layout.taxels.adc_bits) - 1
    scale = 1
    while not _holds(Packing(bits, scale, offset), -(size // 2) * top, size * top):
        scale *= 2
    return Packing(bits, scale, offset)


def rounding_error_n(layout: Layout) -> float:
    """Return the largest error in newtons that the packing adds to one sum; 0 where it is exact."""
    return packing(layout).rounding_counts * layout.taxels.newton_per_count


def _holds(tried: Packing, lowest: int, highest: int) -> bool:
    low, high = tried.raw_range
    raw = tried.raw(np.array([lowest, highest]))
    return low <= int(raw[0]) and int(raw[1]) <= high
