"""Models of recorded touches, our own and those of scikit-learn, judged on touches of another recording."""

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis
from sklearn.ensemble import RandomForestClassifier
from sklearn.linear_model import LogisticRegression
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import MinMaxScaler, StandardScaler
from sklearn.svm import SVC, LinearSVC

import canskin
from canskin.errors import InputError
from canskin.messages import CONTACTS
from classifier.dag import walked
from classifier.dagsvm import DagSvm
from classifier.decide import Classifier
from classifier.learning import export_model, train_recorded
from classifier.model import Model
from classifier.modelfile import load_model
from classifier.recorded import MOST_PER_TOUCH, LabelledTouches, labelled_touches
from classifier.samples import simulate_sums
from dbc.contract import Contract
from recording.sinks import McapSink
from skin.layout import Layout
from skin.phi import Sbhe
from tests import messages as make
from tests.classifier.conftest import SMALL, draw
from tests.documents import block
from tests.layouts import small_layout
from tests.recordings import HOLD, REST, write_touches

pytestmark = pytest.mark.heavy

#: Touches of a recording, of two objects by turns.
COUNT = 24


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, layout: Layout) -> Path:
    """Two recordings of domes and plates."""
    made = tmp_path_factory.mktemp("touches")
    for seed in (1, 2):
        write_touches(made / f"run{seed}.mcap", layout, *draw(COUNT, seed), seed=seed)
    return made


@pytest.fixture(scope="module")
def data(folder: Path) -> LabelledTouches:
    return labelled_touches(folder)


@pytest.fixture(scope="module")
def trained(data: LabelledTouches) -> Model:
    return train_recorded(data)


def accuracy(model: Model, layout: Layout, phi: Sbhe) -> float:
    """Return how many single cycles of other touches get the right label."""
    force_n, labels = draw(200, seed=9)
    sums = simulate_sums(force_n, layout, phi, 0.001, np.random.default_rng(5))
    classifier = Classifier(model, phi, settling=1.0)
    valid = np.ones(phi.blocks, np.bool_)
    return float(np.mean([classifier.decide(each, valid).label for each in sums] == labels))


def test_labelled_cycles_of_touches_and_their_groups(data: LabelledTouches) -> None:
    assert data.labels.tolist() == ["dome"] * HOLD + ["plate"] * HOLD + data.labels.tolist()[2 * HOLD :]
    assert data.touch.tolist() == np.repeat(np.arange(2 * COUNT), HOLD).tolist()
    assert data.recording.tolist() == np.repeat([0, 1], COUNT * HOLD).tolist()
    assert data.files == ("run1.mcap", "run2.mcap")
    assert data.sums.shape == (2 * COUNT * HOLD, 512)
    assert (data.untouched.contact_threshold > 0, data.unlabelled) == (True, 0)
    # Two cycles on each side of a touch are too near.
    assert data.still == 2 * COUNT * (REST - 4) + 2 * 2


def test_a_model_of_recordings_names_touches_of_another(trained: Model, layout: Layout, phi: Sbhe) -> None:
    card = trained.metadata.card
    assert accuracy(trained, layout, phi) > 0.95
    assert (card.touches, card.cycles, card.recordings) == (2 * COUNT, 2 * COUNT * HOLD, ["run1.mcap", "run2.mcap"])
    assert card.validated_by == "recording"
    assert np.sum(card.confusion) == card.validation == card.cycles
    assert card.validation_accuracy == pytest.approx(np.trace(card.confusion) / card.cycles)
    assert card.validation_accuracy > 0.95
    assert card.accuracy_by_touch is not None
    assert card.warnings == []


def test_untouched_skin_has_no_label_and_another_object_is_unknown(trained: Model, layout: Layout, phi: Sbhe) -> None:
    still = np.zeros((100, 32, 32), np.float32)
    ridge = np.zeros((40, 32, 32), np.float32)
    ridge[:, :, 15:17] = 0.01
    valid = np.ones(phi.blocks, np.bool_)
    names = []
    for force_n in (still, ridge):
        classifier = Classifier(trained, phi)
        sums = simulate_sums(force_n, layout, phi, 0.001, np.random.default_rng(6))
        names.append([classifier.decide(each, valid).label for each in sums])
    assert set(names[0]) == {""}
    assert names[1][-1] == "unknown object"


def test_no_touch_is_in_both_halves(monkeypatch: pytest.MonkeyPatch, data: LabelledTouches) -> None:
    fitted: list[set[int]] = []
    rows = {each.tobytes(): int(touch) for each, touch in zip(data.energies, data.touch, strict=True)}

    class Spy(LinearDiscriminantAnalysis):
        def fit(self, X: np.ndarray, y: np.ndarray) -> "Spy":
            fitted.append({rows[np.ascontiguousarray(each).tobytes()] for each in X})
            return super().fit(X, y)

    estimator = Spy().fit(data.energies, data.labels)
    fitted.clear()
    monkeypatch.setattr("classifier.learning.save_model", lambda *_: None)
    export_model("unused.npz", estimator, data)
    halves = [set(range(COUNT)), set(range(COUNT, 2 * COUNT))]
    assert sorted(fitted[:2], key=min) == halves  # whole recordings
    by_touch = fitted[2:]
    assert len(by_touch) == 5
    assert all(sum(touch in each for each in by_touch) == 4 for touch in range(2 * COUNT))  # left out once


def test_few_touches_of_one_recording_are_told(tmp_path: Path, layout: Layout) -> None:
    path = write_touches(tmp_path / "few.mcap", layout, *draw(8, 1))
    card = train_recorded(labelled_touches(path)).metadata.card
    assert card.validated_by == "touch"
    told = " ".join(card.warnings)
    assert "fewer than 10 touches: 'dome' 4, 'plate' 4" in told
    assert "in one recording only: 'dome', 'plate'" in told
    assert "its noise is simulated" in told
    assert card.no_touches == 0


def test_a_label_in_one_recording_only_is_told(tmp_path: Path, layout: Layout) -> None:
    force_n, labels = draw(COUNT, 1)
    paths = [
        write_touches(tmp_path / f"{name}.mcap", layout, force_n[labels == name], labels[labels == name])
        for name in ("dome", "plate")
    ]
    card = train_recorded(labelled_touches(paths)).metadata.card
    assert card.validated_by == "touch"
    assert "in one recording only: 'dome', 'plate'" in " ".join(card.warnings)
    assert (card.validation_accuracy, card.accuracy_by_touch, card.per_object, card.confusion) == (None, None, {}, [])
    why = "12 touches of this label, in one recording"
    assert card.not_validated == {"dome": why, "plate": why}


def test_touches_without_label_are_not_used_and_told(tmp_path: Path, layout: Layout) -> None:
    force_n, labels = draw(COUNT, 1)
    labels[:4] = ""
    data = labelled_touches(write_touches(tmp_path / "run.mcap", layout, force_n, labels))
    assert (data.unlabelled, len(data.labels)) == (4, (COUNT - 4) * HOLD)
    assert "4 touches have no label" in " ".join(train_recorded(data).metadata.card.warnings)


def test_a_board_that_is_dead_leaves_its_sums_out(tmp_path: Path, layout: Layout, phi: Sbhe) -> None:
    path = write_touches(tmp_path / "run.mcap", layout, *draw(2 * COUNT, 1), lost_block=3)
    data = labelled_touches(path)
    assert not data.seen.valid[:, 3].any()
    model = train_recorded(data)
    classifier = Classifier(model, phi, settling=1.0)
    force_n, labels = draw(100, seed=9)
    valid = np.ones(phi.blocks, np.bool_)
    valid[3] = False
    sums = simulate_sums(force_n, layout, phi, 0.001, np.random.default_rng(5))
    assert np.mean([classifier.decide(each, valid).label for each in sums] == labels) > 0.9
    with pytest.raises(InputError, match="expected 3 or more touches of 2 labels or more, got none"):
        train_recorded(data, features="sums")


def test_means_of_cycles_are_trained_as_they_are_classified(tmp_path: Path) -> None:
    fast = small_layout(32, 32, **SMALL | {"sync": {"rate_hz": 100.0}})
    path = write_touches(tmp_path / "run.mcap", fast, *draw(COUNT, 1), rest=30, hold=12)
    data = labelled_touches(path)
    model = train_recorded(data)
    assert (model.metadata.cycles, data.seen.noise_ratio.max() < 1.1) == (4, True)
    classifier, phi = Classifier(model, fast.phi()), fast.phi()
    force_n, labels = draw(60, seed=9)
    last = []
    for each in force_n:
        sums = simulate_sums(np.repeat(each[None], 15, axis=0), fast, phi, 0.001, np.random.default_rng(5))
        last.append([classifier.decide(one, np.ones(phi.blocks, np.bool_)).label for one in sums][-1])
    assert np.mean(np.array(last) == labels) > 0.95


def test_a_recording_without_measurements_is_refused(tmp_path: Path, layout: Layout) -> None:
    path = tmp_path / "run.mcap"
    sink = McapSink(path, Contract.from_layout(layout), 1, 1)
    sink.message(CONTACTS, 1, msgspec.msgpack.encode(make.contacts(1)))
    sink.close()
    with pytest.raises(InputError, match=r"run\.mcap: holds contacts, but no sums for the classifier"):
        labelled_touches(path)


def test_long_touches_give_some_of_their_cycles(
    monkeypatch: pytest.MonkeyPatch, folder: Path, data: LabelledTouches
) -> None:
    assert MOST_PER_TOUCH > HOLD
    monkeypatch.setattr("classifier.recorded.MOST_PER_TOUCH", 3)
    thinned = labelled_touches(folder)
    assert np.bincount(thinned.touch).tolist() == [3] * (2 * COUNT)
    np.testing.assert_array_equal(thinned.sums[:3], data.sums[[0, 2, 5]])


def test_recordings_of_another_skin_are_refused(tmp_path: Path, folder: Path) -> None:
    other = small_layout(32, 32, **SMALL | {"measurement": {"sums": 512, "seed": 2}})
    path = write_touches(tmp_path / "other.mcap", other, *draw(2, 1))
    with pytest.raises(InputError, match=r"other\.mcap: .* another skin than .*run1\.mcap \(`recording\.fingerprint`"):
        labelled_touches([folder, path])


@pytest.mark.parametrize("given", ["none.mcap", "run.txt", ""])
def test_what_is_no_recording_is_refused(tmp_path: Path, given: str) -> None:
    (tmp_path / "run.txt").touch()
    with pytest.raises(InputError, match="expected a recording of 'skin record'"):
        labelled_touches(tmp_path / given)


def test_one_label_trains_nothing(tmp_path: Path, layout: Layout) -> None:
    data = labelled_touches(write_touches(tmp_path / "run.mcap", layout, draw(4, 1).force_n, ["cup"] * 4))
    with pytest.raises(InputError, match="got 4 of 'cup', and 0 without label"):
        train_recorded(data)


ESTIMATORS = {
    "logistic": make_pipeline(StandardScaler(), LogisticRegression()),
    "votes of pairs": make_pipeline(StandardScaler(), SVC(kernel="linear")),
    "one against the rest": make_pipeline(StandardScaler(), StandardScaler(with_mean=False), LinearSVC()),
    "discriminant": LinearDiscriminantAnalysis(),
    "ours": DagSvm(),
}


@pytest.mark.parametrize("name", ESTIMATORS)
@pytest.mark.parametrize("objects", [2, 3])
def test_a_linear_classifier_of_scikit_learn_decides_as_in_scikit_learn(
    data: LabelledTouches, tmp_path: Path, layout: Layout, phi: Sbhe, name: str, objects: int
) -> None:
    labels = data.labels.copy()
    if objects == 3:
        labels[np.isin(data.touch, np.unique(data.touch[labels == "dome"])[::2])] = "cap"
    shown = LabelledTouches(**vars(data) | {"labels": labels})
    estimator = ESTIMATORS[name].fit(data.energies, labels)
    path = tmp_path / "own.npz"
    card = canskin.export_model(path, estimator, shown)
    model = load_model(path, layout, phi)
    assert card == model.metadata.card
    planes = (data.energies - model.offset) * model.scale @ model.weights.T + model.biases
    said = np.array(model.metadata.classes)[walked(planes, objects)[0]]
    assert np.mean(said == estimator.predict(data.energies)) > 0.98
    if objects == 2:
        assert accuracy(model, layout, phi) > 0.9


def test_a_classifier_of_sums_is_taken(
    monkeypatch: pytest.MonkeyPatch, data: LabelledTouches, tmp_path: Path, layout: Layout, phi: Sbhe
) -> None:
    monkeypatch.setattr("classifier.learning.C_GRID", (1.0,))
    path = tmp_path / "sums.npz"
    canskin.export_model(path, LogisticRegression().fit(data.sums, data.labels), data)
    assert load_model(path, layout, phi).metadata.features == "sums"
    assert accuracy(train_recorded(data, features="sums"), layout, phi) > 0.5


def test_the_example_of_the_document_makes_a_model(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, layout: Layout, phi: Sbhe
) -> None:
    (tmp_path / "touches").symlink_to(folder)
    monkeypatch.chdir(tmp_path)
    exec(block("docs/client.md", "labelled_touches"), {})  # noqa: S102
    assert accuracy(load_model(tmp_path / "mine.npz", layout, phi), layout, phi) > 0.9


@pytest.mark.parametrize(
    ("estimator", "says"),
    [
        (SVC(), "SVC: expected a fitted linear classifier of scikit-learn"),
        (RandomForestClassifier(3), "RandomForestClassifier: expected a fitted linear"),
        (make_pipeline(MinMaxScaler(), LogisticRegression()), "a Pipeline with MinMaxScaler: expected"),
    ],
)
def test_other_classifiers_are_refused(data: LabelledTouches, tmp_path: Path, estimator: Any, says: str) -> None:
    with pytest.raises(InputError, match=says):
        export_model(tmp_path / "own.npz", estimator.fit(data.energies, data.labels), data)
    assert not (tmp_path / "own.npz").exists()


def test_classifiers_that_do_not_fit_the_recordings_are_refused(data: LabelledTouches, tmp_path: Path) -> None:
    fitted = LogisticRegression().fit(data.energies, data.labels)
    for estimator, name, says in (
        (LogisticRegression(), "own.npz", "expected a fitted linear"),
        (fitted, "own.pkl", "ends in .npz"),
        (LogisticRegression().fit(data.energies[:, :3], data.labels), "own.npz", "takes 3 features: expected 512"),
        (LogisticRegression().fit(data.energies, data.touch % 2), "own.npz", "expected names"),
        (LogisticRegression().fit(data.energies, np.where(data.labels == "dome", "x", "y")), "own.npz", "knows x, y"),
    ):
        with pytest.raises(InputError, match=says):
            export_model(tmp_path / name, estimator, data)
