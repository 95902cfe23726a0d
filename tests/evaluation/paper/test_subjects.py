"""Every subject, looked at quickly through the command."""

import json
from pathlib import Path

import pytest

from evaluation.command import evaluate
from evaluation.findings import Options
from evaluation.paper import figures, iterations, solvers
from evaluation.paper.printed import SENSOR


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One folder of results: Table III takes up what it shares with Table II."""
    return tmp_path_factory.mktemp("evaluated")


@pytest.mark.slow
@pytest.mark.parametrize(("subject", "count"), [("sparsity", 40), ("compression", 65), ("iterations", 60)])
def test_every_cell_of_a_table_stands_beside_the_papers(
    subject: str, count: int, capsys: pytest.CaptureFixture[str], folder: Path
) -> None:
    evaluate(subject, quick=True, jobs=2, out=folder, json=True)  # type: ignore[arg-type]
    told = json.loads(capsys.readouterr().out)
    assert len(told["rows"]) == count
    for row in told["rows"]:
        assert row["difference"] == pytest.approx(row["ours"] - row["paper"], abs=0.011)
    assert any("A quick look" in note for note in told["notes"])
    assert any("cells within" in note for note in told["notes"])
    golf = [row for row in told["rows"] if row["object"] == "golf-ball" and row.get("basis") == "haar"]
    assert all(abs(row["difference"]) < 2.5 for row in golf)


@pytest.mark.slow
def test_figures_show_what_the_paper_says_of_them() -> None:
    found = figures.evaluate(Options(quick=True))
    level = {row["what"]: row["ours"] for row in found.rows}
    before = [level[f"{sums} sums, before the touch"] for sums in (1365, 1024, 819)]
    after = [level[f"{sums} sums, slide"] for sums in (1365, 1024, 819)]
    assert before == sorted(before)
    assert after == sorted(after, reverse=True)
    assert level["20 iterations"] < level["50 iterations"] < level["100 iterations"]
    assert abs(level["400 iterations"] - level["100 iterations"]) < 0.5
    assert abs(level["sensor signal"] - SENSOR["drill"].mean) < 0.5
    assert {picture.name for picture in found.pictures} >= {"psnr-over-time", "sample-images", "convergence"}
    for picture in found.pictures:
        assert picture.draw().get_axes()


@pytest.mark.slow
def test_solvers_get_the_same_time_and_the_same_minimum() -> None:
    found = solvers.measure(name="golf-ball", meshes=None, step=2500, seed=0)
    paper, exact = "FISTA|L = 2B (paper)|cold", "FISTA, exact step|L = B|cold"
    assert found[f"{paper}|100"]["iterations"] == 100
    for key, each in found.items():
        budget = key.rpartition("|")[2]
        assert each["ms"] == pytest.approx(found[f"{paper}|{budget}"]["ms"], rel=0.15)
    gaps = [each["gap"] for each in found.values() if each["gap"] is not None]
    assert min(gaps) > -1e-9
    assert found[f"{exact}|100"]["gap"] < found[f"{paper}|100"]["gap"] < found[f"{paper}|20"]["gap"]
    assert found["ADMM|ρ = 0.1 B|cold|100"]["gap"] < 1e-3
    assert not any(key.startswith("smoothed L0") and "warm" in key for key in found)


def test_times_are_told_for_every_basis_and_iterations() -> None:
    found = iterations.measure_times(meshes=None, seed=0, steps=3)
    assert set(found) == {f"{basis} {count}" for basis in ("haar", "contourlet") for count in (20, 10, 5)}
    assert all(each > 0 for each in found.values())
