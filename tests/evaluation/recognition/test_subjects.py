"""What must show, on one draw; the whole is averaged over ten."""

from inspect import signature
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from canskin.errors import InputError
from classifier.settling import Decision
from evaluation.recognition import classification, methods_compared, sixteen
from evaluation.recognition.accuracy import measure_accuracy, measure_stepped
from evaluation.recognition.live import measure_live
from evaluation.recognition.methods import METHODS, measure_method
from evaluation.recognition.sixteen import measure_sixteen, skin_of
from evaluation.result import Options
from skin.phi import Sbhe
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
def test_chosen_rows_and_estimated_sums_beat_the_plain_ways() -> None:
    common = {"draw": 0, "splits": [0], "meshes": None, "seed": 0}
    chosen = measure_method(method="rows chosen", size=16, **common)  # type: ignore[arg-type]
    assert chosen["accuracy"][0] >= 0.95 > chosen["plain"][0]
    estimated = measure_method(method="10 % missing: estimated", size=64, **common)  # type: ignore[arg-type]
    assert estimated["accuracy"][0] >= estimated["plain"][0] - 0.02
    zero = measure_method(method="10 % missing: as 0", size=64, **common)  # type: ignore[arg-type]
    assert zero["accuracy"][0] < estimated["accuracy"][0]
    with pytest.raises(KeyError):
        measure_method(method="guessing", size=16, **common)  # type: ignore[arg-type]


@pytest.mark.slow
def test_stepped_sums_are_no_worse_than_16_chosen_sums() -> None:
    found = measure_stepped(splits=[0], meshes=None, seed=0)
    assert found["sums"] == 1024
    assert found["accuracy"][0] >= 0.994


@pytest.mark.slow
def test_quick_subjects_have_rows_of_the_same_keys_and_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    # What cells measure is tested above, and the live service with the classifier: here, one stands in for all of them.
    monkeypatch.setattr(methods_compared, "measure_live", _live)
    monkeypatch.setattr(methods_compared, "measure_sixteen", _sixteen)
    monkeypatch.setattr(methods_compared, "measure_method", _method)
    monkeypatch.setattr(methods_compared, "measure_stepped", _stepped)
    monkeypatch.setattr(classification, "measure_accuracy", _accuracy)
    both = [subject.evaluate(Options(quick=True)) for subject in (classification, methods_compared)]
    for found in both:
        assert len({tuple(row) for row in found.rows}) == 1
        for picture in found.pictures:
            picture.draw()
    named = {row["figure"]: row for row in both[0].rows}
    assert named["volleyball called basketball"]["paper"] == 25
    assert named["volleyball called basketball"]["ours"] == pytest.approx(100 / 16)


def test_live_rows_of_the_sixteen_have_every_share_and_our_shapes(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, answer in (("measure_live", _live), ("measure_sixteen", _sixteen), ("measure_stepped", _stepped)):
        monkeypatch.setattr(methods_compared, name, answer)
    monkeypatch.setattr(methods_compared, "measure_method", _method)
    found = {row["what"]: row["ours"] for row in methods_compared.evaluate(Options(quick=True)).rows}
    named = "live, our shapes of the paper's 16, press, samples a cycle 1"
    shares = {"right, pressed in fully": 95, "right, all cycles": 90, "called unknown": 2, "called no contact": 8}
    assert {what.removeprefix(f"{named}: "): ours for what, ours in found.items() if what.startswith(named)} == shares


def _sixteen(**cell: object) -> dict[str, Any]:
    signature(measure_sixteen).bind(**cell)
    return {"right": 0.9, "held": 0.95, "unknown": 0.02, "empty": 0.08}


@pytest.mark.slow
def test_the_sixteen_pressed_as_in_the_paper_are_recognised_live() -> None:
    found = measure_sixteen(stroke="press", sums=64, samples=1, draw=0, touches=16, per_object=100, seed=0)
    assert 0.8 < found["right"] < found["held"]


def test_blocks_without_sums_are_never_valid_live(monkeypatch: pytest.MonkeyPatch) -> None:
    class Watching:
        def __init__(self, _model: str, phi: Sbhe) -> None:
            self._phi = phi

        def decide(self, sums: npt.NDArray[np.int32], valid: npt.NDArray[np.bool_], _cycle: int) -> Decision:
            assert sums.shape == (16,)
            assert valid.tolist() == self._phi.has_sums.tolist()
            return Decision("cup", 1.0)

    monkeypatch.setattr(sixteen, "Classifier", Watching)
    monkeypatch.setattr(sixteen, "train", lambda *_, **__: "a model")
    monkeypatch.setattr(sixteen, "load_touches", lambda *_, **__: (None, None))
    assert not skin_of(16, 1, 0).phi().has_sums.all()
    found = measure_sixteen(stroke="press", sums=16, samples=1, draw=0, touches=1, per_object=1, seed=0)
    assert found == {"right": 0.0, "held": 0.0, "unknown": 0.0, "empty": 0.0}  # a racquetball touches first


def _accuracy(**cell: object) -> dict[str, Any]:
    signature(measure_accuracy).bind(**cell)
    objects = len(CLASSIFICATION_OBJECTS)
    return {"accuracy": [0.9], "confusion": np.full((objects, objects), 1 / objects).tolist()}


def _method(**cell: object) -> dict[str, list[float]]:
    signature(measure_method).bind(**cell)
    assert cell["method"] in METHODS
    return {"accuracy": [0.9], "plain": [0.8]}


def _stepped(**cell: object) -> dict[str, Any]:
    signature(measure_stepped).bind(**cell)
    return {"accuracy": [0.9], "sums": 1024}


def _live(**cell: object) -> dict[str, float]:
    signature(measure_live).bind(**cell)
    return {"right": 1.0, "unknown": 0.0, "sums": 1024}


@pytest.mark.slow
def test_service_names_a_known_object_in_nearly_every_cycle(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("evaluation.recognition.live.TOUCHES_PER_OBJECT", 150)  # a quarter of those of the service
    known = measure_live(names=["ring"], touches=1, lost_ratio=0.0, noise_ratio=1.0, seed=0)
    assert known["right"] > 0.9
    assert known["right"] + known["unknown"] <= 1
    assert known["sums"] == 1024
    with pytest.raises(InputError, match="1 touch or more, got 0"):
        measure_live(names=["ring"], touches=0, lost_ratio=0.0, noise_ratio=1.0, seed=0)
