"""A simulated skin, where the application is installed."""

from typing import Final

from canskin.application import from_application
from canskin.skin import Skin

#: Group and name of the application's entry point.
GROUP: Final = "canskin.simulation"


def simulate(layout: str | None = None, *, objects: list[str] | None = None, seed: int = 0) -> Skin:
    """Return a simulated skin in this process, without any service: for notebooks and tests.

    Each step of the iteration computes the next cycle, as fast as the machine can; `Skin.latest` computes one, too.

    Parameters
    ----------
    layout : str, optional
        File of a skin's layout, or the name of a shipped one; without it the default skin.
    objects : list of str, optional
        Names of the objects that touch the skin, see ``skin touch objects``; default: a series of five.
    seed : int
        Of touches and noise.

    Raises
    ------
    InputError
        If the application is not installed here.
    """
    make = from_application(GROUP, "simulate", ", or run 'skin demo' and use canskin.connect()")
    skin: Skin = make(layout, objects=objects, seed=seed)
    return skin
