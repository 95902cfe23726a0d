"""The paper's Tables II and III: every Haar cell, and a drawn sample of the contourlet cells."""

import os
import random
from itertools import groupby
from typing import Final

import pytest

from evaluation.paper.runs import Method, cell, measure
from evaluation.printed import Number, printed
from evaluation.result import Options

#: With the paper's meshes where they are, else with our shapes.
MESHES: Final = os.environ.get("SKIN_MESHES")
#: Solver iterations over a trajectory. A start from further back is worse: fewer iterations need nearer steps.
ITERATIONS: Final = {"haar": 8400, "contourlet": 4200}
STEPS: Final = 4200
#: One draw of Φ, of the noise and of the steps in place of the mean over draws and all steps, dB: two deviations.
DRAW_DB: Final = 0.15


def cells(basis: str) -> list[Number]:
    """Return the mean PSNR of every image of the tables, of an object after the other."""
    numbers = [each for each in printed().numbers if each.quantity == "mean" and each.cell.get("basis") == basis]
    return sorted((each for each in numbers if each.subject != "sparsity"), key=lambda each: str(each.cell["object"]))


HAAR: Final = {name: list(group) for name, group in groupby(cells("haar"), lambda each: str(each.cell["object"]))}
DRAWN: Final = random.Random(32).sample(cells("contourlet"), 4)


@pytest.mark.slow
@pytest.mark.parametrize("name", HAAR)
def test_every_haar_cell_is_reached(name: str) -> None:
    assert len(HAAR[name]) == 9
    differences = {each.name: (ours(each) - each.value, tolerance_db(each)) for each in HAAR[name]}
    assert not {number: found for number, found in differences.items() if abs(found[0]) > found[1]}


@pytest.mark.slow
@pytest.mark.parametrize("number", DRAWN, ids=lambda each: each.name)
def test_a_drawn_contourlet_cell_is_reached(number: Number) -> None:
    assert ours(number) == pytest.approx(number.value, abs=tolerance_db(number))


def ours(number: Number) -> float:
    at = number.cell
    iterations = int(at.get("iterations", 20))
    method = Method(at["matrix"], int(at.get("sums", 1024)), at["basis"], iterations)  # type: ignore[arg-type]
    stride = STEPS * iterations // ITERATIONS[method.basis]
    arguments = cell(str(at["object"]), method, Options(), stride=stride) | {"meshes": MESHES}
    return float(measure(**arguments)["mean"])


def tolerance_db(number: Number) -> float:
    return printed().rule[number.rule].tolerance + DRAW_DB
