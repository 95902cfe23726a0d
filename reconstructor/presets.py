"""The solvers one can ask for by name."""

from typing import Final, Literal, TypedDict

from skin.errors import InputError

Prior = Literal["haar-pyramid", "haar-tensor", "d4-pyramid", "d4-tensor", "variation", "contourlet"]


class Settings(TypedDict):
    """The keyword arguments of `reconstructor.engine.Reconstructor`."""

    prior: Prior
    iterations: int
    penalty_n: float
    lipschitz_ratio: float
    spins: int
    nonnegative: bool
    matched: bool
    remembering: bool


#: Total variation on one cycle's sums alone.
VARIATION: Final[Settings] = {
    "prior": "variation",
    "iterations": 10,
    "penalty_n": 0.006,
    "lipschitz_ratio": 1.0,
    "spins": 1,
    "nonnegative": True,
    "matched": True,
    "remembering": False,
}

#: The service's own: total variation on sums averaged as far as the motion allows.
LIVE: Final[Settings] = {**VARIATION, "remembering": True}

#: Cycle-spun Haar, non-negative inside the iteration, the exact step.
SPUN: Final[Settings] = {**VARIATION, "prior": "haar-pyramid", "iterations": 20, "penalty_n": 0.008, "spins": 16}

#: The paper's: tensor Haar, L = 2B, 20 iterations, negative taxels set to 0 at the end alone. The printed λ = 0.1 does
#: not give its tables; a tenth of it does, for Haar and for the contourlet alike.
PAPER: Final[Settings] = {
    "prior": "haar-tensor",
    "iterations": 20,
    "penalty_n": 0.01,
    "lipschitz_ratio": 2.0,
    "spins": 1,
    "nonnegative": False,
    "matched": False,
    "remembering": False,
}

#: The paper's with the contourlet.
PAPER_CONTOURLET: Final[Settings] = {**PAPER, "prior": "contourlet"}

PRESETS: Final[dict[str, Settings]] = {
    "live": LIVE,
    "variation": VARIATION,
    "spun": SPUN,
    "paper": PAPER,
    "paper-contourlet": PAPER_CONTOURLET,
}


def preset(name: str) -> Settings:
    """Return a copy of the settings called `name`.

    Raises
    ------
    InputError
        If there are none.
    """
    if name not in PRESETS:
        raise InputError(f"unknown solver '{name}': expected one of {', '.join(PRESETS)}")
    return PRESETS[name].copy()
