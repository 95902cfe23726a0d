"""``skin reconstruct``: the tactile image of every cycle."""

import threading
from pathlib import Path
from typing import Final

from reconstructor.engine import Reconstructor
from reconstructor.presets import preset
from reconstructor.service import ReconstructorService
from skin.fabric import DEFAULT_ENDPOINT, Fabric
from skin.layout import load_layout
from skin.service import StopSignal, say

#: A start that takes longer says why.
SILENT_S: Final = 4.0


def reconstruct(
    *,
    layout: Path | None = None,
    connect: str = DEFAULT_ENDPOINT,
    solver: str = "live",
    iterations: int | None = None,
    penalty_n: float | None = None,
    noise_n: float | None = None,
) -> None:
    """Turn measurements into tactile images and publish them.

    Parameters
    ----------
    layout
        TOML of the skin; without it the default skin.
    connect
        Endpoint of the fabric's hub, the gateway.
    solver
        ``live``: total variation and non-negative forces on sums averaged as far as the motion allows.
        ``variation``: the same on one cycle's sums alone. ``spun``: cycle-spun Haar wavelets. ``paper``: the paper's,
        tensor Haar, L = 2B. ``paper-contourlet``: the paper's with contourlets.
    iterations
        FISTA iterations per image; without it the solver's own.
    penalty_n
        λ in newtons; without it the solver's own.
    noise_n
        Standard deviation of the sensor's noise in newtons, if it clips at 0: its bias is then corrected.

    Examples
    --------
    skin reconstruct
    skin reconstruct --layout palm.toml --solver paper --iterations 5
    """
    stop = StopSignal().install()
    skin = load_layout(layout)
    settings = preset(solver)
    if iterations is not None:
        settings["iterations"] = iterations
    if penalty_n is not None:
        settings["penalty_n"] = penalty_n
    engine = Reconstructor(skin.phi(), skin.taxels.rows, skin.taxels.columns, noise_n=noise_n, **settings)
    patience = threading.Timer(SILENT_S, say, ("reconstructor", "compiles its solver, as on every first start"))
    patience.start()
    try:
        engine.warm_up()
    finally:
        patience.cancel()
    fabric = Fabric(skin.name, "reconstructor", connect, stop=stop, fingerprint=skin.phi().fingerprint)
    try:
        service = ReconstructorService(skin, engine, fabric)
        say("reconstructor", f"{skin.taxels.rows} x {skin.taxels.columns} taxels, {settings['iterations']} iterations")
        service.run(stop)
    finally:
        fabric.close()
