"""What a taxel source is, and how one is found by name.

A source is anything that can say what every taxel feels at a given step of the skin's clock: a simulator, a
recording, a robot's own electronics. Distributions offer sources as entry points of the group
``canskin.sources``; the nodes load one by name and never import it.
"""

from collections.abc import Callable
from importlib.metadata import entry_points
from typing import Any, Final, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from skin.errors import InputError

#: The objects that touch a simulated skin, and that a classifier knows, when none are named.
DEFAULT_OBJECTS: Final = ("golf-ball", "granola-box", "tuna-can", "ring", "basketball")


class Frame(NamedTuple):
    """One instant of touch: ``force_n`` (rows, columns) in newtons and the touching object's name."""

    force_n: npt.NDArray[np.float32]
    label: str


class TaxelSource(Protocol):
    """What every taxel feels at step 0, 1, 2, … of the SYNC clock."""

    #: True when the source already holds a real sensor's noise, so that none must be added.
    has_noise: bool

    def frame(self, step: int) -> Frame:
        """Return the touch at `step`; the same step always gives the same touch."""
        ...


def load_source(name: str, **options: Any) -> TaxelSource:
    """Build the taxel source registered under `name`.

    Raises
    ------
    InputError
        If no installed distribution offers a source of that name.
    """
    found = {entry.name: entry for entry in entry_points(group="canskin.sources")}
    if name not in found:
        raise InputError(f"unknown taxel source '{name}': expected one of {', '.join(sorted(found))}")
    factory: Callable[..., TaxelSource] = found[name].load()
    return factory(**options)
