"""Searches: what is chosen, that it fits, and what is said when no layout does."""

from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bandwidth.plan import plan, planned
from bandwidth.search import Requirement, Search, nearly_square, search, with_buses
from bandwidth.traffic import Disturbance
from canskin.errors import InputError
from dbc.contract import Contract
from skin.layout import Taxels, changed, load_layout, validated
from tests.layouts import buses, small_layout


@pytest.mark.parametrize(
    ("required", "words"),
    [
        (Requirement(4096, 20, buses=1), "1 bus of classic CAN, 64 nodes of 2 blocks, 1024 sums of 14 bits"),
        (
            Requirement(4096, 100, buses=8, can="classic"),
            "4 buses of classic CAN, 64 nodes of 2 blocks, 1024 sums of 11 bits",
        ),
        (Requirement(4096, 100), "1 bus of CAN FD 5 Mbit/s, 32 nodes of 4 blocks, 1024 sums of 16 bits"),
        (Requirement(1024, 100), "1 bus of classic CAN, 16 nodes of 2 blocks, 256 sums of 11 bits"),
        (
            Requirement(Taxels(rows=24, columns=32), 100),
            "1 bus of classic CAN, 24 nodes of 1 block, 192 sums of 14 bits",
        ),
        (Requirement(101, 100), "1 bus of classic CAN, 4 nodes of 1 block, 128 sums of 16 bits"),
    ],
)
def test_what_is_chosen_meets_the_requirement(required: Requirement, words: str) -> None:
    found = search(required)
    assert found.layout is not None
    assert found.chosen is not None
    assert found.missing() is None
    plans = planned(found.layout, Disturbance())
    assert all(each.load_worst <= required.budget for each in plans)
    assert not any(each.problems for each in plans)
    assert (found.layout.taxels.there, found.layout.sync.rate_hz) == (required.count, required.rate_hz)
    assert all(each.sums < found.chosen.sums for each in found.candidates if each.fits and each is not found.chosen)
    assert found.chosen.words == words


def test_as_many_sums_are_sent_as_the_buses_carry() -> None:
    found = search(Requirement(512, 200, buses=1, can="fd"))
    assert found.chosen is not None
    assert found.chosen.words == "1 bus of CAN FD 5 Mbit/s, 16 nodes of 1 block, 512 sums of 16 bits"
    assert [(each.sums, each.fits) for each in found.candidates] == [(128, True), (512, False), (512, True)]
    assert found.chosen.load_worst == pytest.approx(0.693, abs=0.001)


def test_the_time_within_which_boards_have_to_answer_is_named_where_it_makes_a_skin_fit() -> None:
    required = Requirement(64, 1000, buses=1, can="fd", sending="synchronous")
    missing = search(required).missing() or ""
    assert missing.endswith("and here with boards that answer within 0.7 ms (--jitter-s 0.0007)")
    assert search(required, Disturbance(jitter_s=0.0007)).layout is not None


@pytest.mark.heavy
def test_stepped_sums_are_chosen_where_synchronous_sums_do_not_fit_or_when_asked_for() -> None:
    found = search(Requirement(256, 900, buses=1, can="classic"))
    assert found.layout is not None
    assert found.chosen is not None
    assert found.chosen.words == "1 bus of classic CAN, 8 nodes of 1 block, 256 sums, stepped"
    assert "lacks: " in (why := found.nearest_in_cycles() or "")
    assert "it fits at up to " in why
    assert not any(each.fits for each in found.candidates if each.sending == "synchronous")
    assert found.chosen.load_touched is not None
    assert 0 < found.chosen.load_touched < 0.8
    assert f"{found.chosen.load_touched:.1%} full under simulated touches" in found.chosen.load_words
    planned, *_ = plan(Contract.from_layout(validated(found.layout)), is_touched=False)
    assert (planned.problems, planned.late_random_ms) == ([], found.chosen.late_random_ms)
    asked = search(Requirement(256, 10, buses=1, can="classic", sending="steps"))
    assert asked.layout == found.layout
    assert search(Requirement(256, 1001, buses=1, can="classic")).layout is None


def failed(required: Requirement) -> tuple[str, Search]:
    found = search(required)
    assert (found.layout, found.chosen) == (None, None)
    return found.missing() or "", found


def test_each_try_tells_what_it_lacks() -> None:
    """SYNC and heartbeats have 65 bits at most, a TPDO 135 with 8 bytes, 125 with 7, 105 with 5, 85 with 3.

    254 Hz: two nodes with 8 sums of 16 bits in 3 TPDOs, with 32 in 11, with 16 in 6; the window, 99 % of the period, is
    too short for 11. A stock board answers up to 1 ms late.
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
    # 8 nodes with 32 sums each at 230 Hz: ten TPDOs of three sums and one of two.
    _, most, _ = search(Requirement(256, 230.0, buses=1, can="classic")).candidates
    over = (65 + 8 * (10 * 125 + 105)) * 230 + 8 * 65 - 800_000
    assert (most.missing_bits_per_s, most.window_needed_ms) == (pytest.approx(over), None)
    endless = "a window of any length (1007h): TPDOs of one cycle would still be sent in the next"
    assert most.problem == f"{over} bits a second on each bus (it would be 250.9% full), {endless}"


def test_node_ids_and_identifiers_that_run_out_are_problems_of_a_try() -> None:
    """Beyond 8 TPDOs, 64 nodes have 63 spare node-IDs; beyond 24, 32 nodes have none for all."""
    found = search(Requirement(8192, 5.0, buses=1, can="classic"))
    assert found.chosen is found.candidates[3]
    assert [each.problem for each in found.candidates[1:5]] == [
        "1 node-IDs (128 nodes on a bus of 127)",
        "no identifiers left for TPDO 9 of node 64: put fewer nodes on `$.bus[0]`",
        None,
        "no identifiers left for TPDO 33 of node 1: put fewer nodes on `$.bus[0]`",
    ]


def test_what_was_asked_is_said_again_and_errors_without_end_fit_at_no_rate() -> None:
    required = Requirement(64, 100.0, buses=1, can="classic", sending="synchronous")
    text = search(required, Disturbance(errors_per_s=20_000)).missing() or ""
    assert text.startswith(
        "no layout carries 64 taxels 100 times a second over 1 bus of classic CAN, each at most 80% f"
    )
    assert text.endswith("would still be sent in the next; it fits at no rate")


def test_missing_bits_and_node_ids_are_named() -> None:
    text, found = failed(Requirement(4096, 100, buses=1, can="classic", sending="synchronous"))
    nearest = min((each for each in found.candidates if each.load_worst), key=lambda each: each.load_worst or 0)
    assert nearest.missing_bits_per_s == pytest.approx((nearest.load_worst or 0) * 1e6 - 0.8e6)
    assert f"{nearest.missing_bits_per_s:.0f} bits a second" in text
    assert "6 of 30 lack node-IDs, 1 of them or more on a bus" in text
    assert "window" in text


def test_the_rate_that_is_named_fits_and_a_higher_one_does_not() -> None:
    text, _ = failed(Requirement(4096, 100, buses=1, can="classic", sending="synchronous"))
    assert "it fits at up to 46 Hz" in text
    assert search(Requirement(4096, 46, buses=1, can="classic")).layout is not None
    assert search(Requirement(4096, 46.5, buses=1, can="classic")).layout is None


def test_a_skin_of_too_many_nodes_lacks_node_ids_alone() -> None:
    text, found = failed(Requirement(65536, 1, buses=1, can="classic", sending="synchronous"))
    # 2048 blocks, eight to a node, are 256 nodes: 129 more than node-IDs.
    assert "30 of 30 lack node-IDs, 129 of them or more on a bus" in text
    assert all(each.load_worst is None for each in found.candidates)


def test_a_missing_window_is_named() -> None:
    text, _ = failed(Requirement(4096, 172, buses=1, budget=1.0, can="classic", sending="synchronous"))
    assert "window" in text
    whole = Requirement(1024, 218, buses=1, budget=1.0, can="classic", sending="synchronous")
    tight = [each for each in search(whole).candidates if each.missing_window_ms]
    assert tight
    assert all("ms of window (1007h" in str(each.problem) for each in tight)


@pytest.mark.parametrize(
    ("required", "said"),
    [
        ({"taxels": 65537, "rate_hz": 100}, "64 to 65536"),
        ({"taxels": 32, "rate_hz": 100}, "64 to 65536"),
        ({"taxels": 1024, "rate_hz": 0}, "rate above 0"),
        ({"taxels": 1024, "rate_hz": 2000.5}, "up to 2000 Hz"),
        ({"taxels": 1024, "rate_hz": 10, "buses": 0}, "1 to 16 buses"),
        ({"taxels": 1024, "rate_hz": 10, "buses": 17}, "1 to 16 buses, got 17"),
        ({"taxels": 1024, "rate_hz": 10, "budget": 0.0}, "budget above 0"),
        ({"taxels": 1024, "rate_hz": 10, "budget": 1.001}, "budget above 0"),
    ],
)
def test_a_requirement_out_of_range_is_refused(required: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        Requirement(**required)


def test_limits_of_a_requirement_are_allowed() -> None:
    assert Requirement(64, 2000.0, buses=1).count == 64
    assert Requirement(65536, 1e-3, buses=16, budget=1.0).count == 65536


@given(st.integers(64, 5000))
def test_any_number_of_taxels_has_a_grid(count: int) -> None:
    taxels = nearly_square(count)
    assert taxels.there == count
    assert taxels.columns <= taxels.rows <= 2 * taxels.columns + 1
    assert len(taxels.gaps) < taxels.columns


LAYOUT = small_layout(16, 16, bus=buses(2, 6, names=("left", "right")))


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
