"""Models of skins, trained once and kept in the cache folder."""

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import msgspec

from canskin.errors import ModelError, reasoned
from classifier.model import SIMULATED, VERSION, Features, Model
from classifier.modelfile import load_model, save_model
from classifier.newest_sums import averaged_cycles
from classifier.used_sums import noise_ratios
from shell.output import cache_folder
from shell.service import say
from skin.layout import Layout
from skin.phi import Phi
from skin.sources import DEFAULT_OBJECTS, StrokeKind, load_touches, object_file

TOUCHES_PER_OBJECT: Final = 600
#: The features for each kind of stroke: objects at any place, or near one place as in the paper.
FEATURES: Final[dict[StrokeKind, Features]] = {"slide": "energies", "press": "sums"}


def cached_path(layout: Layout, phi: Phi, objects: Sequence[str], stroke: StrokeKind = "slide") -> Path:
    """Return the path of the model of this skin, these objects and this kind of touch."""
    marks = sorted(map(_mark, objects))
    taxels = msgspec.structs.replace(layout.taxels, masked=None)
    about = msgspec.json.encode([taxels, noise_ratios(layout), marks, *_unusual(layout, stroke)])
    return cache_folder() / f"model-{VERSION}-{phi.fingerprint}-{hashlib.sha256(about).hexdigest()[:8]}.npz"


def _mark(name: str) -> str:
    """Return the name of an object, with a digest of the user's own file."""
    file = object_file(name)
    return name if file is None or not file.is_file() else f"{name}-{hashlib.sha256(file.read_bytes()).hexdigest()}"


def _unusual(layout: Layout, stroke: StrokeKind) -> list[str | int]:
    cycles = averaged_cycles(layout)
    return [*([] if stroke == "slide" else [stroke]), *([] if cycles == 1 else [cycles])]


def keep_model(model: Model, path: Path) -> None:
    """Write `model` to the cache; make the folder if needed. Raise ModelError if the file cannot be written."""
    with reasoned(ModelError, f"{path}: cannot make the cache folder"):
        path.parent.mkdir(parents=True, exist_ok=True)
    save_model(model, path)


def find_or_train(
    layout: Layout, phi: Phi, objects: Sequence[str] = DEFAULT_OBJECTS, stroke: StrokeKind = "slide"
) -> Model:
    """Return the cached model of this skin; without a usable model, train one and keep it first.

    A model of strokes "press" takes the sums as features, as the paper's classifier.
    """
    path = cached_path(layout, phi, objects, stroke)
    if path.exists():
        try:
            return load_model(path, layout, phi)
        except ModelError as error:
            say("classifier", f"{error}; training another")
    force_n, labels = load_touches(objects, TOUCHES_PER_OBJECT * len(objects), layout, seed=0, stroke=stroke)
    say(
        "classifier",
        f"training a model of this skin for {', '.join(objects)}: some seconds, sixteen objects a minute, this once",
    )
    from classifier.training import TrainingOptions, train  # scikit-learn takes a second to load

    model = train(force_n, labels, layout, options=TrainingOptions(features=FEATURES[stroke], data=SIMULATED))
    try:
        keep_model(model, path)
    except ModelError as error:
        say("classifier", f"{error}; it will be trained again next time")
    return model
