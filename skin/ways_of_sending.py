"""How boards send their sums: the facts in which the ways of sending differ."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, Literal

SendingName = Literal["synchronous", "steps"]
#: Default: one sum for this number of taxels.
SUMS_PART: Final = 4
#: Steps of a touch in a second where nodes send in steps; between two steps they interpolate.
STEPPED_STEP_HZ: Final = 100.0
#: Bits of a sum in steps: 2^`SUM_BITS` units are the sum of all taxels of a board at full scale.
SUM_BITS: Final = 13
#: Default: most sums of a bus whose boards send steps. Frames of all of them fit into each slot.
BUS_SUMS: Final = 1024
#: Taxels of a stepped board.
STEPPED_SIZES: Final = (8, 16, 32, 64)


@dataclass(frozen=True, kw_only=True)
class Sending:
    """One way of sending.

    Attributes
    ----------
    in_cycles : bool
        Each SYNC begins a cycle, in which all sums of one instant come. Otherwise frames move the sums of a board when
        that is worth their bits, and the sums hold until then.
    boards_keep_zero : bool
        The boards measure the offsets of their taxels and follow them. Otherwise the gateway does so for the sums.
    taxels_per_sum : int
        Default number of taxels for each sum.
    default_rates_hz : mapping of str to float
        Default `rate_hz` of tables of the layout, where this way of sending has its own.
    step_hz : float or None
        Steps of a touch in a second; None: a step for each SYNC.
    sum_bits : int or None
        A sum of all taxels at full scale has 2^`sum_bits` steps; None: sums have the step of their converters.
    """

    in_cycles: bool
    boards_keep_zero: bool
    taxels_per_sum: int
    default_rates_hz: Mapping[str, float] = field(default_factory=dict)
    step_hz: float | None = None
    sum_bits: int | None = None


#: Sums at every SYNC.
IN_CYCLES: Final = Sending(in_cycles=True, boards_keep_zero=False, taxels_per_sum=SUMS_PART)
#: Sums whenever a frame is worth its bits. The times of the nodes' filter are those of this rate of samples.
STEPPED: Final = Sending(
    in_cycles=False,
    boards_keep_zero=True,
    taxels_per_sum=1,
    default_rates_hz={"sync": 10.0, "sampling": 1000.0},
    step_hz=STEPPED_STEP_HZ,
    sum_bits=SUM_BITS,
)
SENDINGS: Final[Mapping[str, Sending]] = {"synchronous": IN_CYCLES, "steps": STEPPED}
