"""Table I: the golf ball's row, which needs no fitted start."""

import pytest

from evaluation.paper.sparsity import count
from evaluation.printed import paper_value


@pytest.mark.heavy
@pytest.mark.parametrize("basis", ["haar", "d4", "dct"])
def test_golf_ball_is_exact(basis: str) -> None:
    found = count(name="golf-ball", meshes=None, basis=basis, stride=1)
    assert (round(found["mean"], 1), found["max"]) == papers(basis)


@pytest.mark.slow
def test_contourlet_of_the_golf_ball_is_within_a_coefficient() -> None:
    found = count(name="golf-ball", meshes=None, basis="contourlet", stride=150)
    mean, most = papers("contourlet")
    assert abs(found["mean"] - mean) < 1
    assert abs(found["max"] - most) <= 1


def papers(basis: str) -> tuple[float, float]:
    values = [paper_value("sparsity", object="golf-ball", basis=basis, quantity=each) for each in ("mean", "max")]
    assert None not in values
    return values[0] or 0, values[1] or 0
