"""Every subject, looked at quickly through the command."""

import json
from pathlib import Path
from typing import get_args

import pytest

from evaluation.command import Part, RunOptions, paper
from evaluation.paper import figures, sparsity, tables
from evaluation.printed import BasisName, sensor_psnr
from evaluation.result import Options, Result

BASES = get_args(BasisName)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One folder of results: Table III takes up what it shares with Table II."""
    return tmp_path_factory.mktemp("evaluated")


@pytest.mark.slow
@pytest.mark.parametrize(("subject", "count"), [("sparsity", 8), ("compression", 13), ("iterations", 12)])
def test_every_cell_of_an_object_stands_beside_the_papers(
    subject: Part, count: int, capsys: pytest.CaptureFixture[str], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = sparsity if subject == "sparsity" else tables
    monkeypatch.setattr(module, "OBJECTS", ("golf-ball",))
    paper(subject, run=RunOptions(quick=True, jobs=1, out=folder), json=True)
    printed = json.loads(capsys.readouterr().out)
    assert len(printed["rows"]) == count
    for row in printed["rows"]:
        assert row["difference"] == pytest.approx(row["ours"] - row["paper"], abs=0.011)
    golf = [row for row in printed["rows"] if row["object"] == "golf-ball" and row.get("basis") == "haar"]
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
    assert abs(level["sensor signal"] - sensor_psnr("drill").mean) < 0.5
    assert len(found.pictures) == 4
    for picture in found.pictures:
        assert picture.draw().get_axes()


def test_the_report_of_all_parts_compares_every_number(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def part(options: Options) -> Result:
        assert options.draws == 3
        return Result("a part", [{"measured": False}])

    for name in ("settings", "paper.sparsity", "paper.figures", "recognition.classification"):
        monkeypatch.setattr(f"evaluation.{name}.evaluate", part)
    for name in ("compression", "iterations"):
        monkeypatch.setattr(tables, name, part)
    paper(draws=3, run=RunOptions(out=tmp_path), json=True)
    rows = json.loads(capsys.readouterr().out)["rows"]
    assert {row["subject"] for row in rows} == {"paper", *get_args(Part)}
    assert {row["verdict"] for row in rows if row["subject"] == "paper"} == {"not measured"}
    assert {"paper.json", "report.html"} <= {path.name for path in tmp_path.iterdir()}
