"""Labelled touches for training, with the distribution of the taxel source ``objects``."""

import contextlib
from collections.abc import Sequence

import numpy as np

from canskin.errors import InputError
from skin.sources import LabelledTouches, StrokeKind, object_label
from skin.surface import Surface
from touch.contact import PITCH_M, Force, Skin, skin_of
from touch.objects import checked_names
from touch.strokes import LABEL_FORCE_N, TRAINING, draw_touch, random_stream

#: Draws of a moment after which an object counts as not felt on this array.
_MOST_DRAWS = 1000
#: Number of touches that must all be felt for an object to suit an array.
_TRIAL_TOUCHES = 50


def random_touches(
    names: Sequence[str],
    count: int,
    rows: int = 64,
    columns: int = 64,
    *,
    pitch_m: float = PITCH_M,
    surface: Surface | None = None,
    seed: int = 0,
    skip_unfelt: bool = False,
    stroke: StrokeKind = "slide",
) -> LabelledTouches:
    """Return `count` single moments of random touches, true forces without noise.

    Every observation is another touch, at a random moment among the moments that the taxel source labels. So depth,
    position and rotation have the distribution of the taxel source. The objects take turns. No observation repeats a
    touch of the taxel source, for any seeds.

    With `skip_unfelt`, objects that this skin cannot feel are left out. A skin that is no grid has a `surface`.
    """
    if count < 0 or seed < 0:
        raise InputError(f"count and seed need whole numbers of 0 or more: got {count} and {seed}")
    skin = skin_of(rows, columns, pitch_m, surface)
    listed = felt_objects(names, skin) if skip_unfelt else checked_names(names)
    force_n = np.empty((count, *skin.shape), np.float32)
    for index in range(count):
        _observe(listed[index % len(listed)], skin, random_stream(seed, TRAINING, index), force_n[index], stroke)
    labels = np.array([object_label(listed[index % len(listed)]) for index in range(count)], np.str_)
    return LabelledTouches(force_n, labels)


def felt_objects(names: Sequence[str], skin: Skin) -> tuple[str, ...]:
    """Return the named objects that a skin can feel; raise InputError if there are none."""
    felt = []
    image = np.empty(skin.shape, np.float32)
    for name in checked_names(names):
        with contextlib.suppress(InputError):
            for index in range(_TRIAL_TOUCHES):
                _observe(name, skin, random_stream(0, TRAINING, index), image)
            felt.append(name)
    if not felt:
        raise InputError(f"none of {', '.join(names)} can be felt on {skin}")
    return tuple(felt)


def _observe(name: str, skin: Skin, rng: np.random.Generator, out: Force, kind: StrokeKind = "slide") -> None:
    touch = draw_touch(name, skin, rng, kind)
    for _ in range(_MOST_DRAWS):
        pose = touch.stroke.pose(float(rng.uniform(0.0, touch.stroke.duration_s)))
        if pose.depth_m >= LABEL_FORCE_N:
            out[:] = touch.force_n(skin, pose)
            if out.max() >= LABEL_FORCE_N:
                return
    raise InputError(f"'{name}' is never felt with {LABEL_FORCE_N} N on {skin}: use a larger skin or another object")
