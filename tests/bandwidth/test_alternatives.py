"""Which layouts are compared with a given one, and whose figures are told."""

from typing import Any

import msgspec
import pytest

from bandwidth.alternatives import Alternative, alternatives, planned, with_buses
from bandwidth.traffic import Disturbance
from canskin.errors import LayoutError
from skin.layout import Layout, changed, load_layout
from tests.layouts import buses, small_layout

#: Eight blocks, one to a node; the second bus has three times the nodes of the first.
UNEVEN: dict[str, Any] = {"bus": buses(2, 6, names=("left", "right"))}
LAYOUT = small_layout(16, 16, **UNEVEN)


def changes(layout: Layout) -> list[str]:
    return [each.change for each in alternatives(layout)]


FAST = [f"CAN FD {rate} Mbit/s, {blocks} per node" for blocks in (1, 4) for rate in (2, 5, 8)]


#: Of eight sums a node, each with fewer bytes than the one before.
NARROWER = [f"{bits}-bit sums" for bits in (12, 10, 8, 7)]


def test_a_layout_is_compared_with_those_that_differ_in_one_key() -> None:
    assert changes(LAYOUT) == [
        "as it is", "4 buses", *NARROWER, "128 sums", "32 sums",
        "2 blocks per node", "4 blocks per node", "8 blocks per node", *FAST,
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("sums", "others", "widths"),
    [
        (256, [128], [12, 11, 10, 9, 8, 7]),
        (128, [256, 64], [12, 11, 10, 9, 8, 7]),
        (8, [16], [8]),
        (16, [32, 8], [12, 8]),
    ],
)
def test_sums_are_doubled_up_to_the_taxels_and_halved_down_to_one_a_block(
    sums: int, others: list[int], widths: list[int]
) -> None:
    """Of 32 and 16 sums a node more widths have frames of their own than of 8, of one and two sums fewer."""
    told = set(changes(small_layout(16, 16, **UNEVEN, measurement={"sums": sums})))
    same = set(changes(LAYOUT)) - {"128 sums", "32 sums", *NARROWER}
    assert told == same | {f"{each} sums" for each in others} | {f"{bits}-bit sums" for bits in widths}


def test_narrower_sums_and_bigger_nodes_than_the_given_are_compared() -> None:
    layout = LAYOUT
    for bits, narrower in ((16, [14, 12, 10, 8, 7]), (12, [10, 8, 7]), (8, [7]), (7, [])):
        told = changes(changed(layout, encoding={"sum_bits": bits}))
        assert [each for each in told if "-bit" in each] == [f"{each}-bit sums" for each in narrower]
    like = msgspec.structs.replace(layout.bus[0], fd=True, data_bitrate=5_000_000, blocks_per_node=4)
    of_fast = changes(with_buses(layout, 1, like))
    assert [each for each in of_fast if "per node" in each] == [
        "8 blocks per node",
        "CAN FD 2 Mbit/s, 4 per node",
        "CAN FD 8 Mbit/s, 4 per node",
    ]


def test_nodes_of_more_blocks_than_the_skin_can_fill_are_left_out() -> None:
    assert [each for each in changes(small_layout(8, 8)) if "per node" in each] == ["2 blocks per node", *FAST[:3]]


def test_the_figures_are_those_of_the_fullest_bus_and_the_frames_of_all() -> None:
    """Two TPDOs of 8 bytes a node: 65 + 12 * 135 bits at 100 Hz and six heartbeats of 65 bits on the right bus."""
    first = next(alternatives(LAYOUT))
    plans = planned(LAYOUT, Disturbance())
    assert first == Alternative(
        change="as it is",
        buses=2,
        nodes=8,
        sum_bits=14,
        rounding_error_n=pytest.approx(2 * 0.02 / 1023),
        frames_per_cycle=2 * (1 + 2 * 2) + 2 * (1 + 2 * 6) - (1 + 2 * 2) - (1 + 2 * 6),
        load_random=plans[1].load_random,
        load_worst=pytest.approx((65 + 12 * 135) * 100e-6 + 6 * 65e-6),
        max_rate_hz_random=plans[1].max_rate_hz_random,
        max_rate_hz_worst=pytest.approx((1 - 390e-6) / 1685e-6),
        window_needed_ms=pytest.approx(1 + 0.135 + 0.065 + 12 * 0.135),
        problem=None,
    )


def test_figures_of_each_alternative_are_those_of_its_own_layout() -> None:
    found = {each.change: each for each in alternatives(LAYOUT)}
    told = {name: (each.buses, each.nodes, each.sum_bits, each.frames_per_cycle) for name, each in found.items()}
    assert told["4 buses"] == (4, 8, 14, 4 + 16)
    assert told["12-bit sums"] == (2, 8, 12, 2 + 16)
    assert told["7-bit sums"] == (2, 8, 7, 2 + 8)
    assert told["128 sums"] == (2, 8, 14, 2 + 32)
    assert told["32 sums"] == (2, 8, 14, 2 + 8)
    assert told["8 blocks per node"] == (1, 1, 14, 1 + 16)
    assert told["4 blocks per node"] == (2, 2, 14, 2 + 16)
    assert told["CAN FD 2 Mbit/s, 4 per node"] == (2, 2, 14, 2 + 2)
    # 12 bits of sums up to 32 taxels: steps of 16 counts, 8 of them the largest error.
    assert found["12-bit sums"].rounding_error_n == pytest.approx(8 * 0.02 / 1023)
    loads = [found[f"CAN FD {rate} Mbit/s, 1 per node"].load_worst or 0 for rate in (2, 5, 8)]
    assert loads == sorted(loads, reverse=True)


def test_problems_of_all_buses_are_told() -> None:
    first = next(alternatives(changed(LAYOUT, sync={"rate_hz": 2000.0})))
    assert first.problem is not None
    left, _, right = first.problem.partition("; right: ")
    # 65 + 4 * 135 bits 2000 times a second, two heartbeats; then 12 TPDOs, six heartbeats.
    assert f"{605 * 2000 + 130 - 1_000_000} bits a second are missing at 2000 Hz" in left
    assert f"{1685 * 2000 + 390 - 1_000_000} bits a second are missing at 2000 Hz" in right
    assert left.startswith("left: ")


def test_disturbances_lengthen_the_window() -> None:
    calm, rough = (
        next(alternatives(LAYOUT, allowed)).window_needed_ms
        for allowed in (Disturbance(jitter_s=0.0), Disturbance(jitter_s=0.5e-3))
    )
    assert calm is not None
    assert rough == pytest.approx(calm + 0.5)


@pytest.mark.parametrize(
    ("blocks", "buses", "nodes"),
    [(1, 3, [3, 3, 2]), (1, 5, [2, 2, 2, 1, 1]), (2, 3, [2, 1, 1]), (4, 3, [1, 1]), (8, 4, [1]), (1, 1, [8])],
)
def test_nodes_are_divided_evenly_and_buses_without_nodes_are_left_out(
    blocks: int, buses: int, nodes: list[int]
) -> None:
    layout = LAYOUT
    like = msgspec.structs.replace(layout.bus[0], blocks_per_node=blocks, bitrate=250_000)
    made = with_buses(layout, buses, like)
    assert [(bus.name, bus.nodes) for bus in made.bus] == [(f"bus{each}", count) for each, count in enumerate(nodes)]
    assert {(bus.blocks_per_node, bus.bitrate) for bus in made.bus} == {(blocks, 250_000)}
    assert msgspec.structs.replace(made, bus=layout.bus) == layout


def test_a_block_that_is_left_over_has_a_node() -> None:
    odd = changed(LAYOUT, taxels=msgspec.structs.replace(load_layout().taxels, columns=10))
    assert odd.blocks == 20
    made = with_buses(odd, 2, msgspec.structs.replace(odd.bus[0], blocks_per_node=8))
    assert [bus.nodes for bus in made.bus] == [2, 1]


def test_a_layout_that_a_program_has_built_is_checked() -> None:
    assert [each.name for each in planned(LAYOUT, Disturbance())] == ["left", "right"]
    with pytest.raises(LayoutError, match="sums"):
        planned(changed(LAYOUT, measurement={"sums": 512}), Disturbance())
