"""Values of the object dictionary that differ from the default skin's, which test_generate compares as a whole."""

from typing import Any

import pytest

from dbc.contract import Contract
from dbc.dictionary import dictionary
from dbc.objects import Object
from skin.layout import Layout
from tests.layouts import STEPPED, buses, small_layout

STEPPED_ARM = small_layout(**STEPPED)
CYCLES: dict[str, Any] = {
    "measurement": {"sums": 5, "block_size": 64},
    "sync": {"rate_hz": 25.0},
    "encoding": {"sum_bits": 12},
    "bus": buses(1, fd=True, data_bitrate=2_000_000),
}
IN_CYCLES = small_layout(**CYCLES)
#: Data types of CiA 301, 7.4.7.
U8, U16, U32, REAL, U56 = 5, 6, 7, 8, 0x1A


def objects(layout: Layout) -> dict[tuple[int, int | None], Object]:
    contract = Contract.from_layout(layout)
    return {(each.index, each.subindex): each for each in dictionary(contract, contract.nodes[0])}


def told(found: dict[tuple[int, int | None], Object], index: int) -> list[tuple[int, str, float | str | None]]:
    """Return data type, access and value of each sub-index of an object."""
    return [(each.data_type, each.access, each.value) for (at, _), each in found.items() if at == index]


def test_a_board_with_a_thermometer_has_a_temperature() -> None:
    assert (0x2036, None) not in objects(IN_CYCLES)
    for tables in (CYCLES, STEPPED):
        found = objects(small_layout(**tables, taxels={"has_thermometers": True}))
        assert told(found, 0x2036) == [(3, "ro", 0x7FFF)]
        manufacturer = [index for index, _ in found if index >= 0x2000]
        assert manufacturer == sorted(manufacturer)


@pytest.mark.parametrize(
    ("bits", "offset", "kind"),
    [
        (bits, *kind)
        for bits in range(7, 17)
        for kind in (((False, 3), (True, 6)) if bits > 8 else ((False, 2), (True, 5)))
    ],
)
def test_sums_have_the_type_of_their_width_and_sign(bits: int, offset: bool, kind: int) -> None:
    encoding = {"sum_bits": bits, "offset_binary": offset}
    found = objects(small_layout(**CYCLES | {"encoding": encoding}))
    assert [each[0] for each in told(found, 0x2100)] == [U8] + 5 * [kind]


@pytest.mark.parametrize(
    ("rate_hz", "period_us", "window_us"),
    [(0.1, 10_000_000, 9_900_000), (3.0, 333_333, 330_000), (2000.0, 500, 495)],
)
def test_period_and_window_are_microseconds(rate_hz: float, period_us: int, window_us: int) -> None:
    """1006h and 1007h from the slowest to the fastest layout: the window is 99 % of the period."""
    found = objects(small_layout(sync={"rate_hz": rate_hz}))
    assert (found[0x1006, None].value, found[0x1007, None].value) == (period_us, window_us)
