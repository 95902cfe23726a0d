"""What must show, on one draw; the whole is averaged over ten."""

from inspect import signature
from typing import Any

import numpy as np
import pytest

from evaluation.recognition import beyond, classification
from evaluation.recognition.accuracy import measure_accuracy, measure_chosen, measure_stepped
from evaluation.recognition.live import measure_live
from evaluation.result import Options
from touch.classification_poses import CLASSIFICATION_OBJECTS

SHARES = {"development": 0.4, "validation": 0.2, "meshes": None, "seed": 0}


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("kind", "size", "least", "most"),
    [("sbhe", 64, 0.97, 1.0), ("sbhe", 16, 0.87, 0.97), ("averaged", 64, 0.91, 0.96), ("averaged", 16, 0.5, 0.7)],
)
def test_accuracy_is_near_the_papers(kind: str, size: int, least: float, most: float) -> None:
    result = measure_accuracy(kind=kind, size=size, draw=0, splits=[0], **SHARES)  # type: ignore[arg-type]
    assert least <= result["accuracy"][0] <= most
    confusion = np.array(result["confusion"])
    np.testing.assert_allclose(confusion.sum(axis=1), 1, atol=2e-3)
    assert confusion.diagonal().mean() == pytest.approx(result["accuracy"][0], abs=2e-3)


@pytest.mark.heavy
def test_inner_products_give_what_the_signal_itself_gives(monkeypatch: pytest.MonkeyPatch) -> None:
    wanted = {"kind": "sbhe", "size": 64, "draw": 1, "splits": [2], **SHARES}
    direct = measure_accuracy(**wanted)  # type: ignore[arg-type]
    monkeypatch.setattr("evaluation.recognition.accuracy.GRAM_FROM", 64)
    assert measure_accuracy(**wanted)["accuracy"][0] == pytest.approx(direct["accuracy"][0], abs=5e-3)  # type: ignore[arg-type]


@pytest.mark.slow
def test_chosen_rows_beat_drawn_ones() -> None:
    found = measure_chosen(size=16, draw=0, splits=[0], meshes=None, seed=0)
    assert found["accuracy"][0] >= 0.95 > found["plain"][0]


@pytest.mark.slow
def test_stepped_sums_are_no_worse_than_16_chosen_sums() -> None:
    found = measure_stepped(splits=[0], meshes=None, seed=0)
    assert found["sums"] == 1024
    assert found["accuracy"][0] >= 0.994


@pytest.mark.slow
def test_quick_subjects_have_rows_of_the_same_keys_and_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    # What cells measure is tested above, and the live service with the classifier: here, one stands in for all of them.
    monkeypatch.setattr(beyond, "measure_live", _live)
    monkeypatch.setattr(beyond, "measure_chosen", _chosen)
    monkeypatch.setattr(beyond, "measure_stepped", _stepped)
    monkeypatch.setattr(classification, "measure_accuracy", _accuracy)
    both = [subject.evaluate(Options(quick=True)) for subject in (classification, beyond)]
    for found in both:
        assert len({tuple(row) for row in found.rows}) == 1
        for picture in found.pictures:
            picture.draw()
    named = {row["figure"]: row for row in both[0].rows}
    assert named["volleyball called basketball"]["paper"] == 25
    assert named["volleyball called basketball"]["ours"] == pytest.approx(100 / 16)


def _accuracy(**cell: object) -> dict[str, Any]:
    signature(measure_accuracy).bind(**cell)
    objects = len(CLASSIFICATION_OBJECTS)
    return {"accuracy": [0.9], "confusion": np.full((objects, objects), 1 / objects).tolist()}


def _chosen(**cell: object) -> dict[str, list[float]]:
    signature(measure_chosen).bind(**cell)
    return {"accuracy": [0.9], "plain": [0.8]}


def _stepped(**cell: object) -> dict[str, Any]:
    signature(measure_stepped).bind(**cell)
    return {"accuracy": [0.9], "sums": 1024}


def _live(**cell: object) -> dict[str, float]:
    signature(measure_live).bind(**cell)
    return {"right": 1.0, "unknown": 0.0, "sums": 1024}
