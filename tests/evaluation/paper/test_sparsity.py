"""Table I: the golf ball's row, which needs no fitted start."""

import pytest

from evaluation.paper.printed import TABLE_ONE
from evaluation.paper.sparsity import count


@pytest.mark.heavy
@pytest.mark.parametrize("basis", ["haar", "d4", "dct"])
def test_golf_ball_is_exact(basis: str) -> None:
    found = count(name="golf-ball", meshes=None, basis=basis, stride=1)
    assert (round(found["mean"], 1), found["max"]) == TABLE_ONE[basis]["golf-ball"]


@pytest.mark.slow
def test_contourlet_of_the_golf_ball_is_within_a_coefficient() -> None:
    found = count(name="golf-ball", meshes=None, basis="contourlet", stride=150)
    mean, most = TABLE_ONE["contourlet"]["golf-ball"]
    assert abs(found["mean"] - mean) < 1
    assert abs(found["max"] - most) <= 1
