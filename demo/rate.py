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


class RateJudge:
    """Judges once, by the cycles of the first seconds, whether a machine keeps the rate of a run.

    Parameters
    ----------
    is_given : bool
        The rate is kept, whatever the machine does.

    Attributes
    ----------
    is_judged : bool
        The run does not begin again at another rate.
    """

    def __init__(self, *, is_given: bool = False) -> None:
        self.is_judged = is_given
        self._earlier: GatewayStatus | None = None
        self._judge_at_s = 0.0

    def keeps(self, gateway: GatewayStatus | None, elapsed_s: float) -> bool:
        """Tell whether the rate is kept, by the newest state of the gateway."""
        self.is_judged |= elapsed_s > 2 * JUDGED_S
        if self.is_judged or gateway is None or elapsed_s < SETTLED_S:
            return True
        if self._earlier is None:
            self._earlier, self._judge_at_s = gateway, elapsed_s + JUDGED_S - SETTLED_S
        if elapsed_s < self._judge_at_s:
            return True
        self.is_judged = True
        cycles = gateway.cycles - self._earlier.cycles
        return cycles > 0 and gateway.cycles_complete - self._earlier.cycles_complete >= KEPT_RATIO * cycles
