"""The verbs ``skin classify`` and ``skin train``."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np
from cyclopts import Parameter

from canskin.errors import InputError
from classifier.cache import FEATURES, TOUCHES_PER_OBJECT, cached_path, find_or_train, keep_model
from classifier.model import SIMULATED, Features, Metadata, Model, TrainingCard
from classifier.modelfile import load_model, read_model, save_model
from classifier.used_sums import classified_phi
from shell.output import check_new_path, check_output_path, write_file
from shell.pulse import Pulse
from shell.service import StopSignal, request_real_time, say
from shell.skin_options import SkinOptions
from shell.terminal import Json, print_json, print_table, progress
from shell.touch_options import ObjectNames
from shell.worker import serve_skins
from skin.layout import Layout, layout_text, load_layout
from skin.sources import DEFAULT_OBJECTS, StrokeKind, load_touches, object_names
from skin.taxel import NOISE_N


def classify(
    *,
    of: SkinOptions | None = None,
    model: Path | None = None,
    objects: ObjectNames | None = None,
    stroke: StrokeKind | None = None,
) -> None:
    """Name the object that touches the skin, once per measurement; of steps, a hundred times a second.

    Without ``--model``, a model for this skin is trained once and kept in the cache folder: ``$SKIN_CACHE``, else
    ``$XDG_CACHE_HOME/canskin``, else ``~/.cache/canskin``.
    Without ``--layout`` and ``--skin``, every skin of the hub that has a model is served; of several skins those
    without a model are left out. Of two classifiers that serve a skin one stands by.

    Parameters
    ----------
    of
        Which skin.
    model
        Model file from ``skin train`` for this skin, or a folder with a file ``SKIN.npz`` for each.
    objects
        Objects to train on without ``--model``.
    stroke
        Touches to train on without ``--model``, see ``skin nodes``; default: slide.

    Examples
    --------
    skin classify
    skin classify --objects paper
    skin classify --layout palm.toml --model palm.npz
    """
    if model is not None and (objects or stroke is not None):
        raise InputError("--model contains what it was trained on: leave --objects and --stroke out")
    if model is not None and not model.is_dir():
        read_model(model)  # before any wait for a hub

    def find(skin: Layout, *, is_only: bool) -> Model:
        phi = classified_phi(skin)
        if model is not None:
            return load_model(model / f"{skin.name}.npz" if model.is_dir() else model, skin, phi)
        if not is_only and not cached_path(skin, phi, _named(objects), stroke or "slide").exists():
            raise InputError("it has no model: train one, 'skin train --layout FILE', or give --model FOLDER")
        return find_or_train(skin, phi, _named(objects), stroke or "slide")

    serve_skins("classifier", of or SkinOptions(), partial(_serve, find))


def _serve(find: Callable[..., Model], of: SkinOptions, is_only: bool) -> None:
    """Serve one skin, with the model that is found."""
    from classifier.decide import Classifier  # compiled parts take a moment to load
    from classifier.service import make_service

    stop = StopSignal().install()
    pulse = Pulse(stop)
    skin = of.find("classifier", stop)
    trained, classified = find(skin, is_only=is_only), classified_phi(skin)
    # A first decision compiles for a while: before the service is there, and not between two measurements.
    still = np.zeros(classified.shape[0], np.int32), np.ones(classified.blocks, np.bool_)
    Classifier(trained, classified).decide(*still)
    fabric = pulse.fabric = of.join(skin, "classifier", pulse)
    say("classifier", f"knows {', '.join(trained.metadata.classes)}")
    try:
        service = make_service(Classifier(trained, classified), skin, fabric, fabric.instance)
        request_real_time("classifier", fabric.tell_scheduling)
        service.run(stop, pulse.beat)
    finally:
        fabric.close()


def train(
    *,
    layout: Path | None = None,
    objects: ObjectNames | None = None,
    touches: int | None = None,
    noise_n: float = NOISE_N,
    stroke: StrokeKind = "slide",
    features: Features | None = None,
    seed: int = 0,
    out: Path | None = None,
    choose: int | None = None,
    layout_out: Path | None = None,
    recordings: Annotated[list[Path] | None, Parameter(negative=())] = None,
    json: Json = False,
) -> None:
    """Train a classifier for a skin on simulated touches, or on the labelled touches of recordings.

    Of recordings: all cycles of a touch are in one part of the cross-validation, and where each label is in two
    recordings or more, all cycles of a recording. The table is the confusion matrix, or tells which labels have too few
    of both for an accuracy.

    Parameters
    ----------
    layout
        TOML of the skin; without it the default skin.
    objects
        Objects to train on.
    touches
        Total number of touches; default: 600 per object.
    noise_n
        Standard deviation of the taxel noise in newtons.
    stroke
        Touches to train on, see ``skin nodes``.
    features
        ``energies`` of the smoothed adjoint image, or ``sums`` as in the paper; default: energies for ``--stroke
        slide``, sums for ``--stroke press``.
    seed
        Seed of touches, noise and validation set.
    out
        Model file; default: the file in the cache folder that ``skin classify`` uses without ``--model``.
    choose
        Number of rows of Φ that separate the touches best, in place of the layout's; needs ``--layout-out``.
    layout_out
        New layout file with the chosen rows: the model is for this layout.
    recordings
        Recordings (.mcap), or folders of them, whose touches have labels (``skin record --label``, ``skin label``);
        needs ``--out``.
    json
        Print the model card as one JSON object.

    Examples
    --------
    skin train --recordings touches/ --out mine.npz
    skin train --objects golf-ball,ring,tuna-can
    skin train --objects paper --stroke press
    skin train --layout palm.toml --touches 4000 --out palm.npz --json
    skin train --choose 64 --layout-out palm-64.toml --features sums
    """
    if out is not None:
        check_output_path(out, "model", ".npz")
    if recordings is not None:
        if objects or (touches or choose or layout_out) is not None:
            raise InputError(
                "--recordings contain their objects and touches: leave --objects, --touches, --choose, --layout-out out"
            )
        _train_recorded(recordings, layout, out, features or "energies", noise_n=noise_n, seed=seed, as_json=json)
        return
    skin = load_layout(layout)
    names = _named(objects)
    count = TOUCHES_PER_OBJECT * len(names) if touches is None else touches
    if count < 1 or seed < 0:
        raise InputError(f"expected --touches of 1 or more and --seed of 0 or more, got {count} and {seed}")
    if (choose is None) != (layout_out is None):
        raise InputError("--choose and --layout-out belong together: how many sums, and the file for their layout")
    if layout_out is not None:
        check_new_path(layout_out, "layout", ".toml")
    kind = features or FEATURES[stroke]
    skin, model = _train(skin, names, count, stroke, kind, noise_n=noise_n, seed=seed, choose=choose)
    path = out or cached_path(skin, classified_phi(skin), names, stroke)
    (save_model if out else keep_model)(model, path)
    if layout_out is not None:
        write_file(layout_out, layout_text(skin))
        say("train", f"layout with the {choose} chosen rows: {layout_out}")
    _show(model.metadata, path, as_json=json)


def _train_recorded(
    recordings: list[Path],
    layout: Path | None,
    out: Path | None,
    features: Features,
    *,
    noise_n: float,
    seed: int,
    as_json: bool,
) -> None:
    """Train on the touches of recordings."""
    from classifier.learning import train_recorded  # scikit-learn takes a second to load
    from classifier.recorded import labelled_touches

    if out is None:
        raise InputError("--recordings: expected --out FILE for the model, for 'skin classify --model FILE'")
    with progress("reading recordings", 1.0) as bar:
        data = labelled_touches(recordings, layout, noise_n=noise_n, seed=seed)
        model = train_recorded(
            data, features=features, seed=seed, progress=lambda doing, ratio: bar.update(ratio, doing)
        )
    save_model(model, out)
    for line in model.metadata.card.warnings:
        say("train", line)
    _show(model.metadata, out, as_json=as_json)


def _named(objects: list[str] | None) -> list[str]:
    """Return the names of objects, else the default objects."""
    return list(object_names(objects or ()) or DEFAULT_OBJECTS)


def _train(
    skin: Layout,
    names: list[str],
    count: int,
    stroke: StrokeKind,
    features: Features,
    *,
    noise_n: float,
    seed: int,
    choose: int | None,
) -> tuple[Layout, Model]:
    """Train with a progress bar on a terminal's stderr; return layout and model, the layout with the chosen rows."""
    from classifier.training import TrainingOptions, train  # scikit-learn takes a second to load

    with progress("drawing touches", 1.2) as bar:
        force_n, labels = load_touches(names, count, skin, seed=seed, stroke=stroke)
        if choose is not None:
            from classifier.rows import with_chosen_rows

            skin = with_chosen_rows(skin, force_n, labels, choose, noise_n=noise_n, seed=seed)

        def show(doing: str, ratio: float) -> None:
            bar.update(0.2 + ratio, doing)

        options = TrainingOptions(features=features, noise_n=noise_n, seed=seed, data=SIMULATED)
        return skin, train(force_n, labels, skin, options=options, progress=show)


def _show(about: Metadata, path: Path, *, as_json: bool) -> None:
    if as_json:
        print_json({"model": str(path), **msgspec.to_builtins(about)})
        return
    card = about.card
    if card.validation_accuracy is None:
        rows = [(name, f"not validated: {why}") for name, why in card.not_validated.items()]
        print_table(("object", "right on validation"), rows)
    elif card.validated_by:
        _show_confusion(card, card.validation_accuracy)
    else:
        accuracies = card.per_object | {"all": card.validation_accuracy}
        print_table(("object", "right on validation"), [(name, f"{ratio:.1%}") for name, ratio in accuracies.items()])
        say("train", f"C = {card.C:g}, {card.touches} touches, Φ {about.fingerprint}: {path}")
        return
    recordings = f"{card.touches} touches of {len(card.recordings)} recordings"
    say("train", f"C = {card.C:g}, {recordings}, Φ {about.fingerprint}: {path}")


def _show_confusion(card: TrainingCard, accuracy: float) -> None:
    """Print how many cycles that were left out of a training got which label."""
    rows = [*card.confusion, [sum(column) for column in zip(*card.confusion, strict=True)]]
    accuracies = card.per_object | {"all": accuracy}
    print_table(
        ("cycles of", *(f"named {name}" for name in card.per_object), "right"),
        [(name, *row, f"{part:.1%}") for (name, part), row in zip(accuracies.items(), rows, strict=True)],
    )
    say(
        "train",
        f"right: {accuracy:.1%} if the recording of a cycle was left out, {card.accuracy_by_touch:.1%} if its touch",
    )
