"""Decisions cycle by cycle: silence, settling, loss, forgetting."""

import tracemalloc
from pathlib import Path

import msgspec
import numpy as np
import pytest

from canskin.errors import ModelError
from canskin.messages import UNKNOWN_OBJECT
from classifier.decide import Classifier
from classifier.model import Model
from classifier.modelfile import load_model, save_model
from classifier.newest_sums import HOLD_CYCLES
from classifier.samples import simulate_sums
from classifier.training import train
from skin.layout import Layout
from skin.phi import Sbhe
from tests.classifier.conftest import Touches, draw

Sums = np.ndarray
#: Too faint for one cycle.
FAINT_N = 0.0015


@pytest.fixture
def valid(phi: Sbhe) -> np.ndarray:
    return np.ones(phi.blocks, np.uint8)


@pytest.fixture(scope="module")
def idle(layout: Layout, phi: Sbhe) -> Sums:
    still = np.zeros((3000, 32, 32), np.float32)
    return simulate_sums(still, layout, phi, 0.001, np.random.default_rng(77))


@pytest.fixture(scope="module")
def pressed(layout: Layout, phi: Sbhe, unseen: tuple[np.ndarray, np.ndarray]) -> dict[str, Sums]:
    """Twenty cycles of a clear touch of each object."""
    force_n, labels = unseen
    rng = np.random.default_rng(8)
    found = {}
    for name in ("dome", "plate"):
        of_name = np.flatnonzero(labels == name)
        deepest = of_name[np.argmax(force_n[of_name].max(axis=(1, 2)))]
        held = np.repeat(force_n[deepest][None], 20, axis=0)
        found[name] = simulate_sums(held, layout, phi, 0.001, rng)
    return found


@pytest.mark.heavy
def test_untouched_skin_is_silent_as_often_as_stated(model: Model, phi: Sbhe, idle: Sums, valid: np.ndarray) -> None:
    single = Classifier(model, phi, settling=1.0)
    alarms = sum(single.decide(y, valid).label != "" for y in idle)
    assert alarms <= 4 * model.metadata.false_alarm_ratio * len(idle)
    settled = Classifier(model, phi)
    assert all(settled.decide(y, valid).label == "" for y in idle)


def test_new_label_within_three_cycles(
    model: Model, phi: Sbhe, idle: Sums, pressed: dict[str, Sums], valid: np.ndarray
) -> None:
    classifier = Classifier(model, phi)
    for before, after, name in (
        (idle[:20], pressed["dome"], "dome"),
        (pressed["dome"], pressed["plate"], "plate"),
        (pressed["plate"], idle[:20], ""),
    ):
        for y in before:
            classifier.decide(y, valid)
        labels = [classifier.decide(y, valid).label for y in after]
        assert labels[2:] == [name] * 18


def test_sums_of_invalid_blocks_are_ignored(
    model: Model, phi: Sbhe, pressed: dict[str, Sums], valid: np.ndarray
) -> None:
    valid[::8] = 0
    one, other = Classifier(model, phi), Classifier(model, phi)
    garbage = np.where(phi.sums_of_blocks(valid > 0), 0, -30000).astype(np.int32)
    for y in pressed["dome"]:
        assert one.decide(y, valid) == other.decide(y + garbage, valid)
    assert one.decide(pressed["dome"][0], valid).label == "dome"


def test_hardly_any_block_says_nothing(model: Model, phi: Sbhe, pressed: dict[str, Sums], valid: np.ndarray) -> None:
    classifier = Classifier(model, phi)
    few = valid.copy()
    few[phi.blocks // 5 :] = 0
    assert classifier.decide(pressed["dome"][0], few) == ("", 0.0, True)
    assert classifier.decide(pressed["dome"][0], 0 * valid) == ("", 0.0, True)
    assert classifier.decide(pressed["dome"][0], valid).label == "dome"


def test_blocks_that_come_by_turns_are_enough(
    model: Model, phi: Sbhe, pressed: dict[str, Sums], valid: np.ndarray
) -> None:
    classifier = Classifier(model, phi)
    labels = []
    for cycle, y in enumerate(pressed["plate"]):
        turn = (np.arange(phi.blocks) % 5 == cycle % 5).astype(np.uint8)  # a fifth: too few by themselves
        labels.append(classifier.decide(y, turn).label)
    assert labels[0] == ""
    assert set(labels[5:]) == {"plate"}


@pytest.mark.parametrize(("step", "label"), [(11, "plate"), (0, "plate"), (-100, "plate"), (1, "dome"), (10, "dome")])
def test_past_is_forgotten_after_a_gap_of_ten_cycles_or_a_restart(
    model: Model, phi: Sbhe, pressed: dict[str, Sums], valid: np.ndarray, step: int, label: str
) -> None:
    classifier = Classifier(model, phi)
    for cycle, y in enumerate(pressed["dome"], start=1000):
        classifier.decide(y, valid, cycle)
    assert classifier.decide(pressed["plate"][0], valid, 1019 + step).label == label


def test_extreme_sums_give_a_decision(model: Model, phi: Sbhe, valid: np.ndarray) -> None:
    classifier = Classifier(model, phi)
    for value in (-(2**31), 2**31 - 1, 0):
        decision = classifier.decide(np.full(phi.shape[0], value, np.int32), valid)
        assert 0 <= decision.confidence <= 1


def test_object_never_met_is_unknown_while_known_ones_keep_their_name(
    model: Model, layout: Layout, phi: Sbhe, pressed: dict[str, Sums], valid: np.ndarray
) -> None:
    stripes = np.zeros((20, 32, 32), np.float32)
    stripes[:, 4:28, 6::6] = 0.01
    unmet = simulate_sums(stripes, layout, phi, 0.001, np.random.default_rng(3))
    classifier = Classifier(model, phi)
    for y in pressed["plate"]:
        assert classifier.decide(y, valid).label == "plate"
    said = [classifier.decide(y, valid) for y in unmet]
    assert said[-1].label == UNKNOWN_OBJECT
    assert said[-1].confidence > 0.5
    assert [classifier.decide(y, valid).label for y in pressed["dome"]][-1] == "dome"


@pytest.mark.heavy
def test_missing_raw_sums_are_estimated(raw_model: Model, phi: Sbhe, pressed: dict[str, Sums]) -> None:
    most = np.ones(phi.blocks, np.uint8)
    most[::10] = 0
    for name, series in pressed.items():
        whole, part = Classifier(raw_model, phi, settling=1.0), Classifier(raw_model, phi, settling=1.0)
        same = [whole.decide(y, 0 * most + 1).label == part.decide(y, most).label for y in series]
        assert np.mean(same) > 0.8, name


def test_deciding_allocates_nothing_worth_mentioning(
    model: Model, raw_model: Model, phi: Sbhe, pressed: dict[str, Sums], valid: np.ndarray
) -> None:
    valid[0] = 0
    y = pressed["dome"][0]
    # Raw sums that are missing take a solve of this size.
    solve_bytes = 4 * raw_model.sum_loadings.shape[1] ** 2 * raw_model.sum_loadings.itemsize
    for each, most_bytes in ((model, y.nbytes), (raw_model, y.nbytes + solve_bytes)):
        classifier = Classifier(each, phi)
        for _ in range(HOLD_CYCLES + 2):
            classifier.decide(y, valid)
        tracemalloc.start()
        try:
            classifier.decide(y, valid)
            tracemalloc.reset_peak()
            before, _ = tracemalloc.get_traced_memory()
            classifier.decide(y, valid)
            _, peak = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
        assert peak - before < most_bytes  # but for the solve, less than any one array of the measurement


@pytest.fixture(scope="module")
def quick_layout(layout: Layout) -> Layout:
    """One sample a cycle, 100 times a second: the classifier averages over four cycles."""
    return msgspec.structs.replace(layout, sync=msgspec.structs.replace(layout.sync, rate_hz=100.0))


@pytest.fixture(scope="module")
def averaging_model(quick_layout: Layout, touches: Touches) -> Model:
    return train(*touches, quick_layout)


@pytest.mark.heavy
def test_what_one_cycle_does_not_show_the_mean_of_cycles_does(
    quick_layout: Layout, model: Model, averaging_model: Model, phi: Sbhe, valid: np.ndarray
) -> None:
    assert (model.metadata.cycles, averaging_model.metadata.cycles) == (1, 4)
    force_n, _ = draw(1, seed=5)
    faint = np.repeat(force_n * np.float32(FAINT_N / force_n.max()), 60, axis=0)
    sums = simulate_sums(faint, quick_layout, phi, 0.001, np.random.default_rng(3))
    found = {
        each.metadata.cycles: np.mean([classifier.decide(y, valid).label != "" for y in sums[10:]])
        for each in (model, averaging_model)
        for classifier in (Classifier(each, phi),)
    }
    assert found[4] > 0.9
    assert found[1] < 0.3


@pytest.mark.heavy
def test_a_model_that_averages_otherwise_is_refused(
    layout: Layout, averaging_model: Model, phi: Sbhe, tmp_path: Path
) -> None:
    save_model(averaging_model, tmp_path / "model.npz")
    with pytest.raises(ModelError, match=r"`model\.cycles` is 4, this skin has 1"):
        load_model(tmp_path / "model.npz", layout, phi)


@pytest.mark.heavy
def test_an_untouched_skin_is_silent_after_a_start_and_after_losses(
    quick_layout: Layout, averaging_model: Model, phi: Sbhe, valid: np.ndarray
) -> None:
    still = simulate_sums(np.zeros((400, 32, 32), np.float32), quick_layout, phi, 0.001, np.random.default_rng(9))
    classifier = Classifier(averaging_model, phi)
    for turn in range(20):
        for _ in range(5 if turn % 2 else 3):
            assert classifier.decide(0 * still[0], 0 * valid).label == ""
        labels = [classifier.decide(y, valid) for y in still[20 * turn : 20 * turn + 20]]
        assert {each.label for each in labels} == {""}
        assert not labels[-1].blind


@pytest.mark.heavy
@pytest.mark.parametrize(("step", "is_kept"), [(10, True), (12, True), (13, False), (0, False), (-1, False)])
def test_means_go_on_after_a_gap_of_up_to_three_times_the_cycles_that_are_averaged(
    quick_layout: Layout,
    averaging_model: Model,
    phi: Sbhe,
    pressed: dict[str, Sums],
    valid: np.ndarray,
    step: int,
    is_kept: bool,
) -> None:
    """A single cycle does not change a label; where the past is dropped there is none."""
    classifier = Classifier(averaging_model, phi)
    for cycle in range(10):
        assert classifier.decide(pressed["dome"][0], valid, cycle).label == "dome"
    still = simulate_sums(np.zeros((1, 32, 32), np.float32), quick_layout, phi, 0.001, np.random.default_rng(3))[0]
    assert classifier.decide(still, valid, 9 + step).label == ("dome" if is_kept else "")
