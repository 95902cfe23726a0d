"""``skin reconstruct``: the tactile image of every cycle, and its contacts."""

import threading
from pathlib import Path
from typing import Final

import numpy as np

from canskin.errors import InputError
from canskin.fabric import Fabric
from canskin.session import DEFAULT_ENDPOINT
from reconstructor.adaptive import AdaptiveReconstructor
from reconstructor.contacts import ContactTracker
from reconstructor.engine import Reconstructor
from reconstructor.gains import KnownGains
from reconstructor.options import SolverOptions
from reconstructor.service import ReconstructorService
from skin.calibration_file import load_calibration
from skin.layout import Layout, load_layout
from skin.service import StopSignal, say

#: A start that takes longer logs the reason.
SILENT_S: Final = 4.0


def reconstruct(
    *,
    layout: Path | None = None,
    connect: str = DEFAULT_ENDPOINT,
    solver: SolverOptions | None = None,
    gains: Path | None = None,
) -> None:
    """Compute a tactile image from every measurement; publish the image and its contacts.

    Parameters
    ----------
    layout
        TOML of the skin; without it the default skin.
    connect
        Endpoint of the fabric's hub, usually the gateway.
    solver
        Solver of the images; a layout with adaptive sending has one of its own.
    gains
        File of ``skin calibration gain``: gains of the taxels that the nodes do not take off (2010h), and of analogue
        sums.

    Examples
    --------
    skin reconstruct
    skin reconstruct --gains gains.json
    skin reconstruct --layout palm.toml --solver paper --iterations 5
    """
    stop = StopSignal().install()
    skin = load_layout(layout)
    engine, about = make_engine(skin, solver)
    known = load_gains(gains, skin)
    patience = threading.Timer(SILENT_S, say, ("reconstructor", "compiles its solver, as on every first start"))
    patience.start()
    try:
        engine.warm_up()
        ContactTracker(skin.taxels.rows, skin.taxels.columns).warm_up()
    finally:
        patience.cancel()
    fabric = Fabric(skin.name, "reconstructor", connect, stop=stop, fingerprint=skin.phi().fingerprint)
    try:
        service = ReconstructorService(skin, engine, fabric, gains=known)
        say("reconstructor", f"{skin.taxels.rows} x {skin.taxels.columns} taxels, {about}")
        service.run(stop)
    finally:
        fabric.close()


def make_engine(skin: Layout, options: SolverOptions | None) -> tuple[Reconstructor | AdaptiveReconstructor, str]:
    """Return the solver of a skin, and words for the log.

    Raises
    ------
    InputError
        If the options do not fit the skin.
    """
    if skin.sending == "adaptive":
        if options is not None:
            raise InputError(
                "--solver, --iterations, --basis, --penalty-n and --noise-n are for synchronous sending: adaptive sums"
                " have a solver of their own; leave them out"
            )
        return AdaptiveReconstructor(skin), "adaptive sums"
    chosen = options or SolverOptions()
    settings = chosen.settings()
    engine = Reconstructor(
        skin.phi(),
        skin.taxels.rows,
        skin.taxels.columns,
        settings,
        noise_n=chosen.clipped_noise_n(skin),
        samples=skin.samples_per_sync,
    )
    basis = f", basis {settings.prior}" if chosen.basis else ""
    return engine, f"{settings.iterations} iterations{basis}"


def load_gains(path: Path | None, skin: Layout) -> KnownGains | None:
    """Return the gains in a file; None without a file.

    Raises
    ------
    InputError
        If there are none, or the layout has adaptive sending.
    """
    if path is None:
        return None
    if skin.sending == "adaptive":
        raise InputError("--gains is for synchronous sending: write gains to adaptive boards (2010h)")
    stored = load_calibration(path, skin)
    if not stored.gains:
        raise InputError(f"{path}: has no gains of taxels: expected a file of 'skin calibration gain'")
    return KnownGains(np.array(stored.gains), stored.sum_gains())
