"""What a search tries, in which order, what each try lacks, and how that is said.

SYNC and heartbeats have 65 bits at most, a TPDO 135 with 8 bytes, 125 with 7, 105 with 5, 85 with 3. A stock board
answers up to 1 ms late, and its window is 99 % of the period.
"""

from typing import Any

import pytest

from bandwidth.search import Candidate, Requirement, Search, _denser, _layouts, search
from bandwidth.traffic import Disturbance
from canskin.errors import InputError
from dbc.contract import Contract
from skin.layout import Layout, validated


def told(layout: Layout) -> tuple[list[int], int | None, int, int]:
    """Return nodes of each bus, data bit rate, width of sums and blocks per node."""
    first = layout.bus[0]
    assert all(bus.name == f"bus{number}" for number, bus in enumerate(layout.bus))
    assert {(bus.fd, bus.data_bitrate, bus.blocks_per_node) for bus in layout.bus} == {
        (first.data_bitrate is not None, first.data_bitrate, first.blocks_per_node)
    }
    return [bus.nodes for bus in layout.bus], first.data_bitrate, layout.encoding.sum_bits, first.blocks_per_node


#: Of nodes with one and two blocks of eight sums: widths that take fewer frames or bytes than the wider ones.
CLASSIC_WIDTHS = {1: (16, 14, 12, 10, 8, 7), 2: (16, 14, 12, 11, 10, 9, 8, 7)}
FD_WIDTHS = {1: (16, 15, 11, 7), 2: (16, 15, 11, 9, 7)}


def test_few_buses_come_first_then_slow_rates_wide_sums_and_small_nodes() -> None:
    """64 taxels are two blocks: no node has four, and two buses need one each. Sums of 9 bits and fewer come last."""
    tried = [told(layout) for layout in _layouts(Requirement(64, 10.0, buses=2, sending="synchronous"))]
    rates = (None, 2_000_000, 5_000_000, 8_000_000)
    expected = []
    for widths in (range(16, 9, -1), range(9, 6, -1)):
        for nodes in ([([2], 1), ([1], 2)], [([1, 1], 1)]):
            expected += [
                (each, rate, bits, blocks)
                for rate in rates
                for bits in widths
                for each, blocks in nodes
                if bits in (FD_WIDTHS if rate else CLASSIC_WIDTHS)[blocks]
            ]
    assert tried == expected


@pytest.mark.parametrize(
    ("taxels", "rows", "columns"), [(64, 8, 8), (128, 16, 8), (256, 16, 16), (512, 32, 16), (65536, 256, 256)]
)
def test_a_skin_is_a_square_or_twice_as_long_with_a_sum_for_four_taxels(taxels: int, rows: int, columns: int) -> None:
    first = next(_layouts(Requirement(taxels, 12.5, buses=16, can="classic")))
    assert (first.taxels.rows, first.taxels.columns, first.measurement.sums) == (rows, columns, taxels // 4)
    assert first.sync.rate_hz == 12.5


def test_kinds_of_can_are_kept() -> None:
    rates = {
        kind: {told(layout)[1] for layout in _layouts(Requirement(64, 10.0, buses=1, can=kind))}
        for kind in ("any", "classic", "fd")
    }
    fast = {2_000_000, 5_000_000, 8_000_000}
    assert rates == {"any": {None, *fast}, "classic": {None}, "fd": fast}


def test_nodes_are_spread_evenly_over_buses() -> None:
    """Eight blocks over three buses; each bus has a node."""
    tried = [told(layout) for layout in _layouts(Requirement(256, 10.0, buses=3, can="classic", sending="synchronous"))]
    assert [nodes for nodes, _, bits, blocks in tried if bits == 16] == [
        [8], [4], [2], [1], [4, 4], [2, 2], [1, 1], [3, 3, 2], [2, 1, 1],
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("rate", "rates"),
    [
        (None, [None]),
        (2_000_000, [2_000_000, 5_000_000]),
        (5_000_000, [5_000_000]),
        (8_000_000, [8_000_000]),
    ],
)
def test_more_sums_are_sent_one_for_a_taxel_or_for_two_at_rates_of_every_transceiver(
    rate: int | None, rates: list[int | None]
) -> None:
    least = next(layout for layout in _layouts(Requirement(64, 10.0, buses=2)) if told(layout)[1] == rate)
    dense = [(layout.measurement.sums, layout.bus[0].data_bitrate) for layout in _denser(least)]
    assert dense == [(sums, each) for sums in (64, 32) for each in rates]
    assert all([bus.nodes for bus in layout.bus] == [2] for layout in _denser(least))


def test_each_try_tells_what_it_lacks() -> None:
    """254 Hz: two nodes with 8 sums of 16 bits in 3 TPDOs, with 32 in 11, with 16 in 6; the window of 3.9 ms is too
    short for 11.
    """
    found = search(Requirement(64, 254.0, buses=1, can="classic"))
    assert [(each.sums, each.fits) for each in found.candidates] == [(16, True), (64, False), (32, True)]
    least, most, chosen = found.candidates
    assert found.chosen is chosen
    for each, bits in ((least, 2 * 125 + 105), (most, 10 * 125 + 105), (chosen, 5 * 125 + 85)):
        assert each.load_worst == pytest.approx((65 + 2 * bits) * 254e-6 + 2 * 65e-6)
        assert each.window_needed_ms == pytest.approx(1 + 0.135 + 0.065 + 2 * bits * 1e-3)
        assert (each.missing_bits_per_s, each.missing_node_ids) == (0, 0)
    assert most.missing_window_ms == pytest.approx(3.91 - 990 / 254)
    assert most.problem == "0.01 ms of window (1007h, 3.90 ms), or boards that answer sooner (--jitter-s)"
    assert (chosen.missing_window_ms, chosen.problem) == (0, None)
    assert (chosen.buses, chosen.nodes, chosen.blocks_per_node, chosen.sum_bits) == (1, 2, 1, 16)
    assert chosen.data_bitrate is None
    assert found.layout is not None
    assert (found.layout.measurement.sums, [bus.nodes for bus in found.layout.bus]) == (32, [2])


def test_a_try_over_its_budget_or_without_a_bound_says_so() -> None:
    """8 nodes with 32 sums each at 230 Hz, ten TPDOs of three sums and one of two; with 16 five and one of one."""
    _, most, more = search(Requirement(256, 230.0, buses=1, can="classic")).candidates
    over = (65 + 8 * (10 * 125 + 105)) * 230 + 8 * 65 - 800_000
    assert most.missing_bits_per_s == pytest.approx(over)
    assert (most.window_needed_ms, most.missing_window_ms) == (None, None)
    endless = "a window of any length (1007h): TPDOs of one cycle would still be sent in the next"
    assert most.problem == f"{over} bits a second on each bus (it would be 250.9% full), {endless}"
    over = (65 + 8 * (5 * 125 + 85)) * 230 + 8 * 65 - 800_000
    assert more.problem == f"{over} bits a second on each bus (it would be 132.2% full), {endless}"


def test_more_than_127_nodes_lack_node_ids_and_nothing_else_is_known() -> None:
    first, second, third, fourth, *_ = search(Requirement(8192, 5.0, buses=1, can="classic")).candidates
    assert [each.missing_node_ids for each in (first, second, third, fourth)] == [129, 1, 0, 0]
    assert second.problem == "1 node-IDs (128 nodes on a bus of 127)"
    assert (first.load_worst, first.missing_bits_per_s, first.missing_window_ms) == (None, None, None)
    assert fourth.problem is None


def test_identifiers_that_run_out_are_a_problem_of_the_try() -> None:
    """Beyond 8 TPDOs, 64 nodes have 63 spare node-IDs; beyond 24, 32 nodes have none for all."""
    found = search(Requirement(8192, 5.0, buses=1, can="classic"))
    assert found.chosen is found.candidates[3]
    assert [each.problem for each in found.candidates[2:]] == [
        "no identifiers left for TPDO 9 of node 64: put fewer nodes on `$.bus[0]`",
        None,
        "no identifiers left for TPDO 33 of node 1: put fewer nodes on `$.bus[0]`",
        "no identifiers left for TPDO 33 of node 1: put fewer nodes on `$.bus[0]`",
    ]


def test_words_name_buses_nodes_and_sums() -> None:
    def words(**changes: Any) -> str:
        given = {
            "sending": "synchronous", "buses": 1, "nodes": 8, "blocks_per_node": 1, "sums": 64, "sum_bits": 12,
            "data_bitrate": None,
            "load_worst": None, "window_needed_ms": None, "missing_bits_per_s": None, "missing_node_ids": 0,
            "missing_window_ms": None, "problem": "none",
        }  # fmt: skip
        return Candidate(**{**given, **changes}).words

    assert words() == "1 bus of classic CAN, 8 nodes of 1 block, 64 sums of 12 bits"
    assert words(buses=2, blocks_per_node=2, data_bitrate=8_000_000) == (
        "2 buses of CAN FD 8 Mbit/s, 8 nodes of 2 blocks, 64 sums of 12 bits"
    )


def lacking(required: Requirement, *candidates: Candidate, allowed: Disturbance | None = None) -> str:
    return Search(required, allowed or Disturbance(), list(candidates), None, None).missing() or ""


@pytest.mark.parametrize(
    ("required", "asked"),
    [
        (Requirement(64, 0.5, buses=1), "64 taxels 0.5 times a second over 1 bus of CAN or CAN FD, each at most 80%"),
        (
            Requirement(128, 20.0, buses=2, budget=0.25, can="fd"),
            "128 taxels 20 times a second over up to 2 buses of CAN FD, each at most 25%",
        ),
        (
            Requirement(128, 20.0, buses=4, budget=1.0, can="classic"),
            "128 taxels 20 times a second over up to 4 buses of classic CAN, each at most 100%",
        ),
    ],
)
def test_what_was_asked_is_said_again(required: Requirement, asked: str) -> None:
    assert lacking(required) == f"no layout carries {asked} full"


def test_the_try_with_the_least_load_is_the_nearest_and_its_highest_rate_is_named() -> None:
    """64 taxels at 2000 Hz: eight sums of 7 bits a block; the last of all tries, on two buses, is the emptiest."""
    found = search(Requirement(64, 2000.0, buses=2, can="classic"))
    assert found.chosen is found.layout is None
    loads = [each.load_worst or 0 for each in found.candidates]
    assert len(loads) == 20
    assert loads.index(min(loads)) == 19
    text = found.missing() or ""
    assert text.startswith("no layout carries 64 taxels 2000 times a second over up to 2 buses of classic CAN, ")
    near = "the nearest, 2 buses of classic CAN, 2 nodes of 1 block, 16 sums of 7 bits, lacks: "
    # 1 ms, a frame on its way, SYNC and one TPDO of 8 bytes: 1.335 ms. 99 % of the period is 0.495 ms.
    lacks = "0.84 ms of window (1007h, 0.49 ms), or boards that answer sooner (--jitter-s)"
    assert f"; {near}{lacks}; it fits at up to 741.5 Hz" in text
    assert 1.335 <= 990 / 741.5 < 1.335 * 742 / 741.5
    assert "node-IDs" not in text


def test_errors_without_end_fit_at_no_rate() -> None:
    found = search(
        Requirement(64, 100.0, buses=1, can="classic", sending="synchronous"), Disturbance(errors_per_s=20_000)
    )
    assert (found.missing() or "").endswith("would still be sent in the next; it fits at no rate")
    assert len(found.candidates) == 14


@pytest.mark.parametrize(
    "wrong",
    [
        {"taxels": 32},
        {"taxels": 131_072},
        {"rate_hz": 2000.5},
        {"rate_hz": -1.0},
        {"buses": 17},
        {"budget": 0.0},
        {"budget": 1.001},
    ],
)
def test_a_requirement_just_out_of_range_is_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="expected"):
        Requirement(**{"taxels": 64, "rate_hz": 10.0, **wrong})


def test_limits_of_a_requirement_are_allowed() -> None:
    least = Requirement(64, 2000.0)
    assert (least.buses, least.budget, least.can) == (4, 0.8, "any")
    assert Requirement(65536, 1e-3, buses=16, budget=1.0).taxels == 65536
    assert Contract.from_layout(validated(next(_layouts(least)))).phi.shape == (16, 64)
