"""Wishes: what is chosen, that it holds, and what is said when nothing will do."""

import pytest

from bandwidth.alternatives import planned
from bandwidth.search import Candidate, Wish, search, what_is_missing
from bandwidth.traffic import Disturbance
from skin.errors import InputError


@pytest.mark.parametrize(
    ("wish", "words"),
    [
        (Wish(4096, 20, buses=1), "1 bus of classic CAN, 64 nodes of 2 blocks, 16-bit sums"),
        (Wish(4096, 100, buses=8, can="classic"), "4 buses of classic CAN, 128 nodes of 1 block, 12-bit sums"),
        (Wish(4096, 100), "1 bus of CAN FD 5 Mbit/s, 64 nodes of 2 blocks, 16-bit sums"),
        (Wish(1024, 100), "1 bus of classic CAN, 32 nodes of 1 block, 12-bit sums"),
    ],
)
def test_what_is_chosen_meets_the_wish(wish: Wish, words: str) -> None:
    layout, seen = search(wish)
    assert layout is not None
    plans = planned(layout, Disturbance())
    assert all(each.load_worst <= wish.budget for each in plans)
    assert not any(each.problems for each in plans)
    assert (layout.taxels.count, layout.sync.rate_hz) == (wish.taxels, wish.rate_hz)
    assert not any(each.fits for each in seen[:-1])
    assert seen[-1].words == words


def failed(wish: Wish) -> tuple[str, list[Candidate]]:
    layout, seen = search(wish)
    assert layout is None
    return what_is_missing(wish, seen), seen


def test_missing_bits_and_node_ids_are_named() -> None:
    text, seen = failed(Wish(4096, 100, buses=1, can="classic"))
    nearest = min((each for each in seen if each.load_worst), key=lambda each: each.load_worst or 0)
    assert nearest.missing_bits_per_s == pytest.approx((nearest.load_worst or 0) * 1e6 - 0.8e6)
    assert f"{nearest.missing_bits_per_s:.0f} bits a second" in text
    assert "3 of 12 lack node-IDs, 1 of them or more on a bus" in text
    assert "window" in text


def test_the_rate_that_is_named_fits_and_a_higher_one_does_not() -> None:
    text, _ = failed(Wish(4096, 100, buses=1, can="classic"))
    assert "it fits at up to 46 Hz" in text
    assert search(Wish(4096, 46, buses=1, can="classic"))[0] is not None
    assert search(Wish(4096, 46.5, buses=1, can="classic"))[0] is None


def test_a_skin_of_too_many_nodes_lacks_node_ids_alone() -> None:
    text, seen = failed(Wish(65536, 1, buses=1, can="classic"))
    # 2048 blocks, eight to a node, are 256 nodes: 129 more than node-IDs.
    assert "12 of 12 lack node-IDs, 129 of them or more on a bus" in text
    assert all(each.load_worst is None for each in seen)


def test_a_missing_window_is_named() -> None:
    text, _ = failed(Wish(4096, 172, buses=1, budget=1.0, can="classic"))
    assert "window" in text
    whole = Wish(1024, 218, buses=1, budget=1.0, can="classic")
    tight = [each for each in search(whole)[1] if each.missing_window_ms]
    assert tight
    assert all("ms of window (1007h" in str(each.problem) for each in tight)


@pytest.mark.parametrize(
    ("wish", "said"),
    [
        (Wish(1000, 100), "power of two"),
        (Wish(32, 100), "64 to 65536"),
        (Wish(1024, 0), "rate above 0"),
        (Wish(1024, 10, buses=0), "1 to 16 buses"),
        (Wish(1024, 10, budget=1.5), "budget above 0"),
    ],
)
def test_wishes_out_of_range(wish: Wish, said: str) -> None:
    with pytest.raises(InputError, match=said):
        search(wish)
