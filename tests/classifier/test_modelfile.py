"""The model file: what is written is read, and everything else is refused in one line."""

import io
import pickle
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from canskin.errors import ModelError
from classifier.model import ARRAYS, Model
from classifier.modelfile import load_model, save_model
from skin.layout import Layout
from skin.phi import Sbhe

Entries = dict[str, np.ndarray]


@pytest.fixture
def path(tmp_path: Path, model: Model) -> Path:
    file = tmp_path / "model.npz"
    save_model(model, file)
    return file


def change(path: Path, edit: Callable[[Entries], object]) -> None:
    with np.load(path) as file:
        entries = dict(file)
    edit(entries)
    np.savez(path, **entries)


def restate(path: Path, **fields: object) -> None:
    """Change fields of the metadata."""

    def edit(entries: Entries) -> None:
        about = msgspec.json.decode(entries["metadata"].tobytes())
        about.update(fields)
        entries["metadata"] = np.frombuffer(msgspec.json.encode(about), np.uint8)

    change(path, edit)


def test_round_trip(path: Path, model: Model, layout: Layout, phi: Sbhe) -> None:
    loaded = load_model(path, layout, phi)
    assert loaded.metadata == model.metadata
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(loaded, name), getattr(model, name))
    assert [file.name for file in path.parent.iterdir()] == ["model.npz"]  # no draft is left


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ({"version": 1}, "version 1 of the model format, expected 2"),
        ({"fingerprint": "0123456789abcdef"}, "another skin .`model.fingerprint` is '0123456789abcdef'"),
        ({"sums": 500}, "another skin .`model.sums` is 500, this skin has 512"),
        ({"rows": 64}, "another skin .`model.rows`"),
        ({"newton_per_count": 1.0}, "another skin .`model.newton_per_count`"),
        ({"classes": ["dome", "dome"]}, "different object names"),
        ({"classes": ["dome", "plate", "cup"]}, "'weights' is float64"),
        ({"features": "sums"}, "'weights' is float64"),
        ({"features": "pixels"}, "damaged model: .*features"),
        ({"contact_threshold": 3.0}, "digest does not fit"),
        ({"surprise": 1}, "surprise"),
    ],
)
def test_metadata_that_does_not_fit(
    path: Path, layout: Layout, phi: Sbhe, fields: dict[str, object], says: str
) -> None:
    restate(path, **fields)
    with pytest.raises(ModelError, match=says):
        load_model(path, layout, phi)


@pytest.mark.parametrize(
    ("old", "new"), [(b'"dome"', b'"d\xffme"'), (b'{"version":2', b'{"other":' + 99_999 * b"[" + b',"version":2')]
)
def test_metadata_that_is_no_json(path: Path, layout: Layout, phi: Sbhe, old: bytes, new: bytes) -> None:
    def edit(entries: Entries) -> None:
        changed = entries["metadata"].tobytes().replace(old, new, 1)
        entries["metadata"] = np.frombuffer(changed, np.uint8)

    change(path, edit)
    with pytest.raises(ModelError, match="damaged model"):
        load_model(path, layout, phi)


@pytest.mark.parametrize("name", ARRAYS)
def test_arrays_that_do_not_fit(path: Path, raw_model: Model, layout: Layout, phi: Sbhe, name: str) -> None:
    if name.startswith("sum_"):
        save_model(raw_model, path)
    original = path.read_bytes()
    # How many regions there are, the limits say: with one less it is the centres that do not fit.
    other = {"limits": "centres", "sum_loadings": "digest"}.get(name, name)
    for edit, says in (
        (lambda array: array * np.nan, "not finite"),
        (lambda array: array[..., :-1], "digest does not fit" if other == "digest" else f"'{other}' is float64"),
        (lambda array: array.astype(np.float32), f"'{name}' is float32"),
        (lambda array: array + 1e-6, "digest does not fit"),
    ):
        path.write_bytes(original)
        change(path, lambda entries, edit=edit: entries.update({name: edit(entries[name])}))
        with pytest.raises(ModelError, match=says):
            load_model(path, layout, phi)


def test_missing_entry(path: Path, layout: Layout, phi: Sbhe) -> None:
    change(path, lambda entries: entries.pop("biases"))
    with pytest.raises(ModelError, match="lacks biases"):
        load_model(path, layout, phi)


def test_pickled_objects_are_not_loaded(path: Path, layout: Layout, phi: Sbhe) -> None:
    with np.load(path) as file:
        entries = dict(file)
    entries["weights"] = np.array([{"never": "loaded"}], object)
    np.savez(path, allow_pickle=True, **entries)
    with pytest.raises(ModelError, match="not a readable model"):
        load_model(path, layout, phi)


def test_files_that_are_no_models(tmp_path: Path, layout: Layout, phi: Sbhe) -> None:
    file = tmp_path / "x.npz"
    with pytest.raises(ModelError, match="cannot read the model: No such file"):
        load_model(file, layout, phi)
    with pytest.raises(ModelError, match="Is a directory"):
        load_model(tmp_path, layout, phi)
    array = io.BytesIO()
    np.save(array, np.zeros(3))
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w") as bundle:
        for name in (*ARRAYS, "metadata", "digest"):
            bundle.writestr(f"{name}.npy", b"nothing")
    for content in (b"", b"nonsense", pickle.dumps([1]), array.getvalue(), archive.getvalue()):
        file.write_bytes(content)
        with pytest.raises(ModelError):
            load_model(file, layout, phi)


@pytest.mark.heavy
@given(data=st.data())
def test_damage_anywhere_is_noticed_or_harmless(
    data: st.DataObject, model: Model, layout: Layout, phi: Sbhe, tmp_path_factory: pytest.TempPathFactory
) -> None:
    file = tmp_path_factory.mktemp("damaged") / "model.npz"
    save_model(model, file)
    content = bytearray(file.read_bytes())
    if data.draw(st.booleans()):
        del content[data.draw(st.integers(0, len(content) - 1)) :]
    else:
        content[data.draw(st.integers(0, len(content) - 1))] ^= data.draw(st.integers(1, 255))
    file.write_bytes(content)
    try:
        loaded = load_model(file, layout, phi)
    except ModelError:
        return
    assert loaded.metadata == model.metadata
    np.testing.assert_array_equal(loaded.weights, model.weights)


def test_unwritable_place(model: Model, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ModelError, match="cannot write the model"):
        save_model(model, tmp_path / "file" / "model.npz")


def test_deviation_of_zero_is_refused(model: Model, layout: Layout, phi: Sbhe, tmp_path: Path) -> None:
    no_touch = model.no_touch.copy()
    no_touch[3, 0] = 0.0
    save_model(replace(model, no_touch=no_touch), tmp_path / "model.npz")
    with pytest.raises(ModelError, match="above 0"):
        load_model(tmp_path / "model.npz", layout, phi)
