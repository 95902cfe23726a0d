"""Every claim of the paper in a row: the paper's numbers, and what is measured beside them."""

from collections.abc import Callable, Sequence
from inspect import signature
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from evaluation import claims
from evaluation.bench import claimed as bench
from evaluation.paper import claimed as paper
from evaluation.recognition import claimed as recognition
from evaluation.result import Options, Row
from evaluation.schemes import claimed as schemes
from evaluation.schemes import frontend


def canned(function: Callable[..., Row], answer: Callable[..., Row]) -> Callable[..., Row]:
    """Return what answers in place of a function, for its arguments alone."""

    def measured(**cell: Any) -> Row:
        signature(function).bind(**cell)
        return answer(**cell)

    return measured


def front_end(effect: Row, **_: Any) -> Row:
    """Answer as a converter for each taxel; for each sum with the same λ, with a λ that fits."""
    if effect["is_digital"]:
        return {"psnr_db": 30.0, "frames": 70}
    return {"psnr_db": 30.5 if effect["keeps_penalty"] else 32.0, "frames": 70}


@pytest.fixture(scope="module")
def rows() -> dict[str, Row]:
    """What the subject says when each measurement gives a known number."""
    answers: tuple[tuple[ModuleType, str, Callable[..., Row]], ...] = (
        (paper, "measure", lambda method, **_: {"mean": 30.0 if method.basis == "haar" else 32.0}),
        (paper, "measure_sensor", lambda **_: {"mean": 29.0}),
        (paper, "measure_times", lambda **_: {f"{basis} 20": 4.0 for basis in ("haar", "contourlet")}),
        (
            recognition,
            "measure_accuracy",
            lambda kind, size, **_: {"accuracy": [0.9 + 0.001 * size / 64 - 0.2 * (kind != "sbhe")]},
        ),
        (recognition, "measure_sixteen", lambda sums, **_: {"held": 0.97 if sums == 64 else 0.9}),
        (
            schemes,
            "measure_skin",
            lambda **_: (
                {"image_db": 45.0, "sensor_db": 29.0, "cycles": 10, "complete": 9}
                | {"sums_kbit_per_s": 3000.0, "scan_kbit_per_s": 7500.0}
            ),
        ),
        (bench, "measure_decisions", lambda **_: {"sums_us": 2.0, "taxels_us": 11.0}),
        (frontend, "measure", front_end),
    )
    with pytest.MonkeyPatch.context() as patch:
        for module, name, answer in answers:
            patch.setattr(module, name, canned(getattr(module, name), answer))
        patch.setattr(paper, "convergence", lambda _: {paper.FROM_ZERO: (28.0, None)})
        found = claims.evaluate(Options(quick=True)).rows
    assert len({tuple(row) for row in found}) == 1
    assert {row["mode"] for row in found} == {"offline", "live"}
    return {f"{row['claim']}: {row['quantity']}": row for row in found}


def row_of(rows: dict[str, Row], words: str) -> Row:
    (found,) = (row for name, row in rows.items() if words in name)
    return found


def test_papers_numbers_are_those_of_its_text_and_tables(rows: dict[str, Row]) -> None:
    """Means and worst of the five objects, by hand from Table II; 6.4 and 7.7 ms of Table III."""
    for words, printed in (
        ("sensor, haar, mean", 0.32),
        ("sensor, haar, worst", -1.7),
        ("sensor, contourlet, mean", 1.74),
        ("sensor, contourlet, worst", -6.8),
        ("PSNR of images, haar", 28.98),
        ("images a second, haar", 156.74),
        ("complete cycles a second", 100.0),
        ("objects, 64 sums, 60 % training", 98.0),
        ("16 sums, 60 % training", 93.2),
        ("right label, 16 objects, our shapes, 64 sums", 98.0),
        ("accuracy of 64 sums - accuracy of 64 coarse", 4.7),
        ("accuracy of 16 sums - accuracy of 16 coarse", 33.2),
        ("taxels / sums", 4.0),
        ("conversions in a cycle", 4.0),
    ):
        assert row_of(rows, words)["paper"] == pytest.approx(printed, abs=0.01)


def test_our_numbers_are_what_was_measured(rows: dict[str, Row]) -> None:
    for words, ours in (
        ("sensor, haar, mean", 1.0),
        ("sensor, contourlet, worst", 3.0),
        ("images a second, contourlet", 250.0),
        ("PSNR of sensor, 5 objects", 16.0),
        ("complete cycles a second", 90.0),
        ("bits on the bus", 2.5),
        ("objects, 64 sums, 60 % training", 90.1),
        ("64 sums - accuracy of all 4096 taxels", 100 * (0.901 - 0.764)),
        ("right label, 16 objects, our shapes, 64 sums", 97.0),
        ("right label, 16 objects, our shapes, 16 sums", 90.0),
        ("for each taxel, same λ", 0.5),
        ("for each taxel, λ that fits", 2.0),
        ("conversions in a cycle", 4.0),
        ("time of a decision", 5.5),
        ("taxels / chains", 32.0),
    ):
        assert row_of(rows, words)["ours"] == pytest.approx(ours, abs=0.01)


def test_only_what_ran_on_boards_is_live(rows: dict[str, Row]) -> None:
    live = [row["quantity"] for row in rows.values() if row["mode"] == "live"]
    wanted = (
        "PSNR of images - PSNR of sensor, 5",
        "complete cycles",
        "bits on the bus",
        "cycles of a full press",
        "cycles of a full press",
    )
    assert len(live) == len(wanted)
    for quantity, words in zip(sorted(live), sorted(wanted), strict=True):
        assert quantity.startswith(words)


def test_a_star_has_a_wire_to_every_taxel() -> None:
    """Taxels at the corners of a square of 2 pitches, and on a line."""
    blocks = np.array([[0, 2, 20, 22], [5, 6, 7, 8]])
    assert schemes.star_length_m(blocks, 10, 0.004) == pytest.approx(0.004 * (4 * 2**0.5 + 1.5 + 0.5 + 0.5 + 1.5))


def test_a_decision_is_made_between_all_pairs_of_objects_from_sums_and_from_taxels(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Times are medians of the turns, 3 and 20 µs."""
    called: list[list[tuple[int, ...]]] = []

    def race(calls: Sequence[Callable[[], Any]], rounds: int) -> list[list[float]]:
        assert rounds == 3
        for call in calls:
            call()
        return [[2e-6, 3e-6, 9e-6], [20e-6, 10e-6, 70e-6]]

    def descend(values: Any, weights: Any, biases: Any, classes: int) -> None:
        assert classes == 16
        called.append([values.shape, weights.shape, biases.shape])

    monkeypatch.setattr(bench, "race", race)
    monkeypatch.setattr(bench, "descend", descend)
    assert bench.measure_decisions(rounds=3, seed=0) == pytest.approx({"sums_us": 3.0, "taxels_us": 20.0})
    assert called == [[(size,), (120, size), (120,)] for size in (64, 4096)]


@pytest.mark.slow
def test_images_of_the_default_skin_are_better_than_its_sensor() -> None:
    found = schemes.measure_skin(name="golf-ball", ticks=400, meshes=None, seed=0)
    assert found["cycles"] == found["complete"] == 40
    assert found["image_db"] > found["sensor_db"] + 3
    assert 7400 < found["scan_kbit_per_s"] < 8400  # 640 frames of 8 bytes, 100 Hz, 116 to 131 bits
    assert 2900 < found["sums_kbit_per_s"] < 3200
