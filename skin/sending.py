"""How boards send their sums: the facts in which the ways of sending differ."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, Literal

SendingName = Literal["synchronous", "adaptive"]
#: Default: one sum for this number of taxels.
SUMS_PART: Final = 4
#: Steps of a touch in a second where nodes send adaptively; between two steps they interpolate.
ADAPTIVE_STEP_HZ: Final = 100.0
#: Identifiers that a bus has for adaptive sums of one kind and urgency: one for each node and frame of a node.
IDENTIFIERS: Final = 128
#: Groups of sums that a CAN FD frame carries at most; a classic frame carries one.
FD_GROUPS: Final = 4
#: Taxels of an adaptive board.
ADAPTIVE_SIZES: Final = (8, 16, 32, 64)
#: Coarse step of adaptive sums near 0, in parts of a taxel's full scale: 0.5 mN of 20 mN.
COARSE_STEP_RATIO: Final = 1 / 40


def groups_of_frame(groups: int, is_fd: bool) -> int:
    """Return how many groups of sums of an adaptive board with `groups` travel in one frame."""
    return min(groups, FD_GROUPS) if is_fd else 1


def columns_of(groups: int, is_fd: bool) -> int:
    """Return how many boards with `groups` groups have identifiers of their own: those of node-IDs so far apart."""
    return IDENTIFIERS // groups * groups_of_frame(groups, is_fd)


@dataclass(frozen=True, kw_only=True)
class Sending:
    """One way of sending.

    Attributes
    ----------
    in_cycles : bool
        Each SYNC begins a cycle, in which all sums of one instant come. Otherwise a sum comes when it carries news, and
        holds until it comes again.
    boards_keep_zero : bool
        The boards measure the offsets of their taxels and follow them. Otherwise the gateway does so for the sums.
    taxels_per_sum : int
        Default number of taxels for each sum.
    default_rates_hz : mapping of str to float
        Default `rate_hz` of tables of the layout, where this way of sending has its own.
    step_hz : float or None
        Steps of a touch in a second; None: a step for each SYNC.
    coarse_step_ratio : float or None
        Step of a sum near 0, in parts of a taxel's full scale; None: the step of its converters.
    """

    in_cycles: bool
    boards_keep_zero: bool
    taxels_per_sum: int
    default_rates_hz: Mapping[str, float] = field(default_factory=dict)
    step_hz: float | None = None
    coarse_step_ratio: float | None = None


#: Sums at every SYNC.
IN_CYCLES: Final = Sending(in_cycles=True, boards_keep_zero=False, taxels_per_sum=SUMS_PART)
#: Sums whenever they carry news. The times of `dbc.adaptive.SendingRule` and of the nodes' filter are those of these
#: rates.
ADAPTIVE: Final = Sending(
    in_cycles=False,
    boards_keep_zero=True,
    taxels_per_sum=1,
    default_rates_hz={"sync": 10.0, "sampling": 1000.0},
    step_hz=ADAPTIVE_STEP_HZ,
    coarse_step_ratio=COARSE_STEP_RATIO,
)
SENDINGS: Final[Mapping[str, Sending]] = {"synchronous": IN_CYCLES, "adaptive": ADAPTIVE}
