"""The verbs, the cache, and where touches come from."""

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import msgspec
import numpy as np
import pytest

from canskin.errors import InputError, ModelError
from canskin.fabric import Fabric
from classifier.cache import cached_path, find_or_train
from classifier.command import classify, train
from classifier.model import Model
from classifier.modelfile import load_model, save_model
from shell.skin_options import SkinOptions
from skin import sources
from skin.layout import Layout, load_layout
from skin.phi import Sbhe
from skin.sources import load_touches
from tests.classifier.conftest import SMALL, draw
from tests.layouts import layout_toml
from tests.processes import PATIENCE_S
from tests.recordings import HOLD, write_touches

NAMES = ("dome", "plate")


class Offer:
    """Stands in for an installed entry point."""

    name = "random"

    def __init__(self, force_n: np.ndarray, labels: np.ndarray) -> None:
        self.touches = force_n, labels
        self.calls: list[tuple[list[str], int]] = []

    def load(self) -> "Offer":
        return self

    def __call__(
        self, names: Sequence[str], count: int, *, rows: int, columns: int, pitch_m: float, seed: int, skip_unfelt: bool
    ) -> tuple[np.ndarray, np.ndarray]:
        assert (rows, columns, pitch_m, seed) == (32, 32, 0.004, 0)
        self.calls.append((list(names), count))
        return self.touches


@pytest.fixture
def offer(monkeypatch: pytest.MonkeyPatch, touches: tuple[np.ndarray, np.ndarray]) -> Offer:
    made = Offer(*touches)
    monkeypatch.setattr(sources, "entry_points", lambda **_: [made])
    return made


@pytest.fixture
def trained(monkeypatch: pytest.MonkeyPatch, model: Model) -> None:
    """Give out a model that was trained before, for the tests of the cache."""
    monkeypatch.setattr("classifier.training.train", lambda *_, **__: model)


@pytest.fixture(autouse=True)
def cache(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    monkeypatch.setenv("SKIN_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


@pytest.fixture
def small(tmp_path: Path) -> Path:
    file = tmp_path / "small.toml"
    file.write_text(layout_toml(32, 32, **SMALL, name="small"))
    return file


@pytest.mark.heavy
def test_train_writes_a_model_and_tells(
    offer: Offer, small: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out.npz"
    train(layout=small, objects=["dome, plate", "dome"], touches=240, out=out, json=True)
    told = json.loads(capsys.readouterr().out)
    assert offer.calls == [(["dome", "plate"], 240)]
    assert told["model"] == str(out)
    assert told["card"]["per_object"].keys() == set(NAMES)
    skin = load_layout(small)
    assert load_model(out, skin, skin.phi()).metadata.fingerprint == told["fingerprint"]


@pytest.mark.heavy
@pytest.mark.usefixtures("offer")
def test_train_writes_a_layout_with_the_rows_that_it_chose(small: Path, tmp_path: Path) -> None:
    out, chosen = tmp_path / "out.npz", tmp_path / "chosen.toml"
    train(layout=small, objects=["dome", "plate"], touches=240, out=out, choose=8, layout_out=chosen, features="sums")
    skin = load_layout(chosen)
    assert (skin.measurement.sums, skin.phi().shape[0]) == (8, 8)
    assert load_model(out, skin, skin.phi()).metadata.card.validation_accuracy > 0.9
    with pytest.raises(InputError, match="belong together"):
        train(layout=small, choose=8)
    with pytest.raises(InputError, match="another name"):
        train(layout=small, objects=["dome", "plate"], choose=8, layout_out=small)
    with pytest.raises(InputError, match=r"expected a file for the layout that ends in \.toml, got '\.npz'"):
        train(layout=small, objects=["dome", "plate"], choose=8, layout_out=tmp_path / "rows.npz")


@pytest.mark.usefixtures("trained")
def test_train_prints_a_table_and_keeps_the_model_for_classify(
    offer: Offer, small: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    train(layout=small, objects=["dome", "plate"], touches=240)
    captured = capsys.readouterr()
    assert "dome" in captured.out
    assert "C = " in captured.err
    skin = load_layout(small)
    assert find_or_train(skin, skin.phi(), NAMES).metadata.classes == ["dome", "plate"]
    assert len(offer.calls) == 1  # not trained again


@pytest.mark.usefixtures("trained")
def test_missing_model_is_trained_once_with_a_word(
    offer: Offer, layout: Layout, phi: Sbhe, capsys: pytest.CaptureFixture[str]
) -> None:
    first = find_or_train(layout, phi, NAMES)
    again = find_or_train(layout, phi, NAMES)
    assert first.metadata == again.metadata
    assert offer.calls == [(["dome", "plate"], 1200)]
    assert capsys.readouterr().err.count("training a model of this skin for dome, plate") == 1


@pytest.mark.usefixtures("trained")
def test_damaged_cache_is_replaced(offer: Offer, layout: Layout, phi: Sbhe, capsys: pytest.CaptureFixture[str]) -> None:
    path = cached_path(layout, phi, NAMES)
    path.parent.mkdir(parents=True)
    path.write_bytes(b"not a model")
    model = find_or_train(layout, phi, NAMES)
    assert "training another" in capsys.readouterr().err
    assert load_model(path, layout, phi).metadata == model.metadata


@pytest.mark.usefixtures("trained")
def test_cache_that_cannot_be_written_is_no_obstacle(
    offer: Offer, layout: Layout, phi: Sbhe, cache: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cache.write_text("a file where the folder should be")
    assert find_or_train(layout, phi, NAMES).metadata.classes == ["dome", "plate"]
    assert "again next time" in capsys.readouterr().err


def test_no_touches_offered(monkeypatch: pytest.MonkeyPatch, layout: Layout) -> None:
    monkeypatch.setattr(sources, "entry_points", lambda **_: [])
    with pytest.raises(InputError, match=r"no 'random' in .*'canskin\.touches': installed .* offer nothing"):
        load_touches(NAMES, 20, layout, seed=0)


@pytest.mark.heavy
def test_train_takes_recordings_and_tells_their_confusion(
    layout: Layout, small: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for seed in (1, 2):
        write_touches(tmp_path / f"run{seed}.mcap", layout, *draw(12, seed), seed=seed)
    out = tmp_path / "mine.npz"
    train(recordings=[tmp_path], out=out)
    told = capsys.readouterr()
    table = [line.split() for line in told.out.splitlines()]
    assert table[0] == ["cycles", "of", "named", "dome", "named", "plate", "right"]
    assert [line[0] for line in table[1:]] == ["dome", "plate", "all"]
    assert sum(int(each) for line in table[1:3] for each in line[1:3]) == 2 * 12 * HOLD
    assert "if the recording of a cycle was left out" in told.err
    skin = load_layout(small)
    assert load_model(out, skin, skin.phi()).metadata.card.recordings == ["run1.mcap", "run2.mcap"]
    train(recordings=[tmp_path], out=out, json=True)
    assert json.loads(capsys.readouterr().out)["card"]["validated_by"] == "recording"


@pytest.mark.heavy
def test_train_tells_no_accuracy_of_touches_of_one_recording(
    layout: Layout, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run, out = write_touches(tmp_path / "run.mcap", layout, *draw(12, 1)), tmp_path / "mine.npz"
    train(recordings=[run], out=out)
    told = capsys.readouterr()
    table = [line.split(maxsplit=1) for line in told.out.splitlines()]
    why = "not validated: 6 touches of this label, in one recording"
    assert [(name, text.strip()) for name, text in table[1:]] == [("dome", why), ("plate", why)]
    assert "%" not in told.out + told.err
    train(recordings=[run], out=out, json=True)
    card = json.loads(capsys.readouterr().out)["card"]
    assert (card["validation_accuracy"], card["accuracy_by_touch"], card["per_object"]) == (None, None, {})
    assert b"not_validated" in np.load(out)["metadata"].tobytes()


def test_options_that_recordings_do_not_take(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--recordings: expected --out FILE"):
        train(recordings=[tmp_path])
    with pytest.raises(InputError, match="--recordings contain their objects"):
        train(recordings=[tmp_path], objects=["ring"], out=tmp_path / "m.npz")


def test_wrong_options(small: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="the folder for the model does not exist"):
        train(layout=small, out=tmp_path / "none" / "m.npz")
    assert not (tmp_path / "none").exists()
    with pytest.raises(InputError, match=r"expected a file for the model that ends in \.npz, got '\.txt'"):
        train(layout=small, out=tmp_path / "m.txt")
    with pytest.raises(InputError, match="leave --objects and --stroke out"):
        classify(of=SkinOptions(layout=small), model=tmp_path / "x.npz", objects=["ring"])
    with pytest.raises(InputError, match="leave --objects and --stroke out"):
        classify(model=Path("palm.npz"), stroke="press")
    with pytest.raises(ModelError, match="cannot read the model"):
        classify(model=tmp_path / "x.npz")  # before it looks for a hub


def test_of_several_skins_each_has_its_model_or_is_left_out(
    small: Path, model: Model, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    finds: list[Callable[..., Model]] = []
    monkeypatch.setattr("classifier.command.serve_skins", lambda _service, _of, serve: finds.append(serve.args[0]))
    skin, models = load_layout(small), tmp_path / "models"
    models.mkdir()
    save_model(model, models / f"{skin.name}.npz")
    for folder in (None, models):
        classify(model=folder)
    without, with_folder = finds
    assert with_folder(skin, is_only=False).metadata == model.metadata
    with pytest.raises(ModelError, match=r"other\.npz: cannot read"):
        with_folder(msgspec.structs.replace(skin, name="other"), is_only=False)
    monkeypatch.setenv("SKIN_CACHE", str(tmp_path))
    with pytest.raises(InputError, match="it has no model: train one"):
        without(skin, is_only=False)


@pytest.fixture
def hub(endpoint: str) -> Iterator[Fabric]:
    fabric = Fabric("small", "hub", endpoint, hub=True)
    yield fabric
    fabric.close()


@pytest.mark.heavy
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_service_comes_alive_and_ends_quietly(
    model: Model, small: Path, hub: Fabric, endpoint: str, number: signal.Signals
) -> None:
    out = small.with_suffix(".npz")
    save_model(model, out)
    alive = threading.Event()
    hub.watch(lambda name, there: alive.set() if there and name == "classifier" else None)
    command = [sys.executable, "-m", "skin", "classify"]
    options = ["--layout", str(small), "--model", str(out), "--connect", endpoint]
    process = subprocess.Popen([*command, *options], stderr=subprocess.PIPE, text=True, env=dict(os.environ))
    try:
        assert alive.wait(PATIENCE_S)
        process.send_signal(number)
        _, said = process.communicate(timeout=240)
    finally:
        process.kill()
    assert process.returncode == 0
    assert "Traceback" not in said
