"""What the paper prints, held against itself, and the verdict on ours."""

from collections import Counter
from pathlib import Path

import pytest

from canskin.errors import InputError
from evaluation import reached
from evaluation.printed import paper_psnr, paper_value, printed, sensor_psnr
from evaluation.reached import Ours
from evaluation.result import Options
from evaluation.settings import SETTINGS, cycle_figures
from touch.trajectory import ACQUISITION_OBJECTS

NUMBERS = {each.name: each for each in printed().numbers}


def test_every_number_of_the_tables_is_there_and_every_range_holds_its_mean() -> None:
    counted = Counter(each.where for each in printed().numbers)
    assert (counted["Table I"], counted["Table II"], counted["Table III"]) == (5 * 4 * 2, 30 * 6 + 15, 30 * 4 + 15)
    levels = [sensor_psnr(name) for name in ACQUISITION_OBJECTS]
    for each in printed().numbers:
        if each.quantity == "mean" and each.subject in {"compression", "iterations"}:
            levels.append(paper_psnr(each.subject, **each.cell))
        elif each.quantity == "mean":
            most = paper_value("sparsity", **each.cell | {"quantity": "max"})
            assert most is not None
            assert each.value < most
    assert len(levels) == 5 + 2 * 5 + 60 + 30
    assert all(each.least < each.mean < each.most for each in levels)


def test_twenty_iterations_of_table_three_are_the_noiselet_of_table_two() -> None:
    of_three = [each for each in printed().numbers if each.quantity == "mean" and each.cell.get("iterations") == 20]
    assert len(of_three) == 10
    for each in of_three:
        cell = {"object": each.cell["object"], "basis": each.cell["basis"], "sums": 1024}
        found = paper_psnr("iterations", **each.cell)
        assert found == paper_psnr("compression", matrix="noiselet", **cell)
        assert found != paper_psnr("compression", matrix="sbhe", **cell)


def test_every_number_has_a_name_of_its_own_a_rule_and_a_subject() -> None:
    assert len(NUMBERS) == len(printed().numbers)
    assert {each.rule for each in printed().numbers} == set(printed().rule)
    assert all(rule.why for rule in printed().rule.values())


@pytest.fixture(scope="module")
def settings() -> dict[str, float]:
    """Every setting of ours, and every figure of the default skin's cycles, from a slide that is cut short."""
    return SETTINGS | cycle_figures(200, meshes=None, seed=0)


@pytest.mark.heavy
def test_every_setting_is_ours_and_every_cycle_is_complete(settings: dict[str, float]) -> None:
    assert {each.cell["setting"] for each in printed().numbers if each.subject == "settings"} == set(settings)
    assert settings["taxels / sums"] == settings["conversions of taxels / of sums"] == 4
    assert settings["complete cycles a second"] == pytest.approx(100)
    assert 120 < settings["cycles a second of four buses"] < 150


@pytest.mark.parametrize(
    ("name", "ours", "verdict"),
    [
        ("Table I, granola-box, dct, max", 602, "reached"),
        ("Table I, granola-box, dct, max", 584, "worse, within the tolerance"),  # 3 % of 602 are 18.06
        ("Table I, granola-box, dct, max", 583, "not reached"),
        ("Table I, granola-box, dct, max", 621, "not reached"),
        ("Table II, sbhe, haar, golf-ball, 1024, mean", 31.06, "reached"),  # 31.1 as printed
        ("Table II, sbhe, haar, golf-ball, 1024, mean", 31.04, "worse, within the tolerance"),
        ("Table II, sbhe, haar, golf-ball, 1024, mean", 30.6, "not reached"),
        ("Table II, sbhe, haar, golf-ball, 1024, mean", 40.0, "reached"),
        ("Table III, sbhe, haar, golf-ball, 20, time", 6.5, "not reached"),
        ("Table III, sbhe, haar, golf-ball, 20, time", 0.2, "reached"),
        ("section VII-B-1, accuracy, 16 SBHE sums", 93.1, "not reached"),
        ("section VII-B-2, accuracy, 16 coarse taxels, 60 % training", 60.1, "not reached"),
        ("section VII-B-2, accuracy, 16 coarse taxels, 60 % training", None, "not measured"),
    ],
)
def test_verdict(name: str, ours: float | None, verdict: str) -> None:
    (judged,) = reached.judged([Ours(name, ours)])
    assert judged.verdict == verdict


def test_ours_is_the_one_row_that_has_the_cell() -> None:
    rows = [
        {"signal": "SBHE", "size": 16, "training_percent": 60.0, "ours": 91.5, "sd_runs": 2.0},
        {"signal": "sensor", "size": 4096, "training_percent": 60.0, "ours": 99.75, "sd_runs": 0.1},
    ]
    found = {each.number: each for each in reached.compare({"classification": rows})}
    name = "section VII-B-1, accuracy, 16 SBHE sums"
    assert found[name] == Ours(name, 91.5, 2.0)
    assert found["section VII-B-2, accuracy of 4096 taxels - of 16 SBHE, 60 % training"].ours == 8.25
    assert found["section VII-B-1, accuracy, 16 noiselet products"].ours is None
    unmeasured = reached.compare({"classification": [rows[0] | {"ours": float("nan")}]})
    assert {each.ours for each in unmeasured} == {None}
    with pytest.raises(ValueError, match=r"expected one row with .*'signal': 'SBHE'.*, got 2"):
        reached.compare({"classification": [rows[0], *rows]})


@pytest.mark.heavy
def test_what_is_not_reached_comes_first_and_a_file_keeps_all(tmp_path: Path, settings: dict[str, float]) -> None:
    rows = [{"setting": name, "ours": 0.0 if name == "rotations" else ours} for name, ours in settings.items()]
    for name in ("banana", "cup", "drill", "largeclamp", "mustard"):
        (tmp_path / f"{name}.ply").touch()
    kept = reached.stored({"settings": rows}, Options(meshes=tmp_path, seed=3))
    (tmp_path / "paper.json").write_text(reached.encoded(kept))
    assert reached.read(tmp_path / "paper.json") == kept
    assert kept.made.command == f"skin evaluate paper --meshes {tmp_path.name} --seed 3"
    found = reached.result(kept.numbers)
    assert [row["verdict"] for row in found.rows] == ["not reached"] * 2 + ["reached"] * (len(settings) - 2)
    assert {row["number"] for row in found.rows[:2]} == {"section V-B, rotations", "section VI-A-3, λ for SBHE, N"}
    assert f"{len(settings)} printed numbers: 2 not reached, 0 not measured" in found.note
    (tmp_path / "other.json").write_text("{}")
    with pytest.raises(InputError, match=r"'.*other\.json' is no comparison of 'skin evaluate paper'"):
        reached.read(tmp_path / "other.json")
