"""The highest rate: a step more breaks the plan, and published rates are met where bits alone decide."""

from pathlib import Path

import msgspec
import pytest

from bandwidth.highest_rate import STEP_HZ, highest_rate_hz
from bandwidth.plan import planned
from bandwidth.traffic import Disturbance
from canskin.errors import InputError
from skin.layout import SHIPPED, Layout, load_layout
from tests.layouts import in_one_instant

#: Shipped layouts whose nodes send in every cycle, at any rate.
IN_CYCLES = [name for name in SHIPPED for layout in [load_layout(Path(name))] if layout.sending == "synchronous"]


def at(layout: Layout, rate_hz: float) -> Layout:
    return msgspec.structs.replace(layout, sync=msgspec.structs.replace(layout.sync, rate_hz=rate_hz))


@pytest.mark.parametrize("name", IN_CYCLES)
@pytest.mark.parametrize("budget", [0.8, 1.0])
def test_the_highest_rate_fits_and_a_step_more_does_not(name: str, budget: float) -> None:
    layout = load_layout(Path(name))
    rate_hz = highest_rate_hz(layout, budget)

    def fits(tried_hz: float) -> bool:
        plans = planned(at(layout, tried_hz), Disturbance())
        return all(each.load_worst <= budget and not each.problems for each in plans)

    assert fits(rate_hz)
    assert not fits(rate_hz + STEP_HZ)


def test_published_rates_at_80_percent() -> None:
    assert highest_rate_hz(in_one_instant()) == pytest.approx(92, rel=0.01)
    assert highest_rate_hz(load_layout()) == pytest.approx(2 * 91, rel=0.01)  # each round has two SYNCs
    assert highest_rate_hz(load_layout(Path("fd"))) == pytest.approx(0.8 * 184, rel=0.01)


def test_no_rate_keeps_the_window_of_a_bus_full_of_errors() -> None:
    assert highest_rate_hz(load_layout(), 0.8, Disturbance(errors_per_s=20_000)) == 0


@pytest.mark.parametrize("wrong", [{"jitter_s": -1.0}, {"sdo_per_s": float("nan")}, {"errors_per_s": float("inf")}])
def test_disturbances_that_no_bus_has(wrong: dict[str, float]) -> None:
    with pytest.raises(InputError, match="needs a number from 0"):
        Disturbance(**wrong)
