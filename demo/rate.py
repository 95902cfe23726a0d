"""The rate that a machine keeps: what the first seconds of a run say, and a layout of another rate."""

from typing import Final

from canskin.errors import InputError, LayoutError
from canskin.messages import GatewayStatus
from skin.choice import averaged_hz
from skin.layout import Layout, changed, validated

#: Since the first cycle of a run: services that start take more of the processor until `SETTLED_S`; cycles from then to
#: `JUDGED_S` judge the rate. Runs shorter than `LEAST_RUN_S` keep the layout's.
SETTLED_S: Final = 1.0
JUDGED_S: Final = 3.0
LEAST_RUN_S: Final = 10.0
#: Least part of complete cycles at a rate that a machine keeps; an idle machine has 0.94 and more.
KEPT_RATIO: Final = 0.75
#: The least rate is this part of the layout's.
LEAST_PART: Final = 1 / 8


def at_rate(layout: Layout, rate_hz: float) -> Layout:
    """Return a layout of another SYNC rate, with as many samples in a cycle where boards can take them.

    Raises
    ------
    InputError
        If the layout cannot have this rate.
    """
    other = changed(layout, sync={"rate_hz": rate_hz})
    if layout.samples_per_sync > 1 and rate_hz > 0:
        other = changed(other, sampling={"rate_hz": averaged_hz(other, layout.samples_per_sync)})
    try:
        return validated(other)
    except LayoutError as error:
        raise InputError(f"--sync-rate {rate_hz:g}: {error}") from error


def is_kept(earlier: GatewayStatus, now: GatewayStatus) -> bool:
    """Tell whether enough of the cycles between two states of a gateway are complete."""
    cycles = now.cycles - earlier.cycles
    return cycles > 0 and now.cycles_complete - earlier.cycles_complete >= KEPT_RATIO * cycles
