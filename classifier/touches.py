"""Touches to train on, found by name; distributions offer them in the group ``canskin.touches``."""

from collections.abc import Callable, Sequence
from importlib.metadata import entry_points
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from skin.errors import InputError
from skin.layout import Layout
from skin.sources import DEFAULT_OBJECTS

GROUP: Final = "canskin.touches"
#: What a model card says of touches from here.
SOURCE: Final = "simulated touches at random places, depths and moments"


def load_touches(
    names: Sequence[str], count: int, layout: Layout, *, seed: int, offer: str = "random"
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.str_]]:
    """Return `count` labelled touches of the named objects, drawn by the offer called `offer`.

    An offer is called as ``offer(names, count, rows=, columns=, pitch_m=, seed=, skip_unfelt=)`` and gives images
    and labels. Of the default objects, those that the skin is too small for are left out.

    Returns
    -------
    force_n : array of float32, shape (count, rows, columns)
        True forces in newtons.
    labels : array of str, shape (count,)

    Raises
    ------
    InputError
        If nothing installed offers such touches, or a name is unknown to the offer.
    """
    found = {entry.name: entry for entry in entry_points(group=GROUP)}
    if offer not in found:
        raise InputError(
            f"nothing installed offers '{offer}' touches (entry points of '{GROUP}':"
            f" {', '.join(sorted(found)) or 'none'}): install one, or give a trained model with --model"
        )
    draw: Callable[..., Any] = found[offer].load()
    taxels = layout.taxels
    force_n, labels = draw(
        list(names),
        count,
        rows=taxels.rows,
        columns=taxels.columns,
        pitch_m=taxels.pitch_m,
        seed=seed,
        skip_unfelt=tuple(names) == DEFAULT_OBJECTS,
    )
    return np.asarray(force_n, np.float32), np.asarray(labels, np.str_)
