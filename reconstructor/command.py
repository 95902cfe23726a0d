"""``skin reconstruct``: the tactile image of every cycle, and its contacts."""

from contextlib import closing
from pathlib import Path

from canskin.errors import InputError
from reconstructor.imaging import make_imager
from reconstructor.options import SolverOptions
from reconstructor.service import ReconstructorService, warm_up
from shell.pulse import Pulse
from shell.service import StopSignal, say
from shell.skin_options import SkinOptions
from shell.worker import serve_skins
from skin.limits import read_file


def reconstruct(
    *,
    of: SkinOptions | None = None,
    solver: SolverOptions | None = None,
    gains: Path | None = None,
) -> None:
    """Compute a tactile image from every measurement; publish the image and its contacts.

    Without ``--layout`` and ``--skin``, of every skin of the hub, also of those that come later. Of two that serve a
    skin one stands by.

    Parameters
    ----------
    of
        Which skin.
    solver
        Solver of the images; steps have one of their own, and take the solvers of one cycle besides.
    gains
        File of ``skin calibration gain``: gains of the taxels that the nodes do not take off (2010h), and of analogue
        sums.

    Examples
    --------
    skin reconstruct
    skin reconstruct --gains gains.json
    skin reconstruct --layout palm.toml --solver paper --iterations 5
    """
    (solver or SolverOptions()).settings()  # its errors before any wait, and those of a file
    if gains is not None:
        read_file(gains, InputError, "the gains")
    serve_skins("reconstructor", of or SkinOptions(), lambda skin, _: _serve(skin, solver, gains))


def _serve(of: SkinOptions, solver: SolverOptions | None, gains: Path | None) -> None:
    """Serve one skin."""
    stop = StopSignal().install()
    pulse = Pulse(stop)
    skin = of.find("reconstructor", stop)
    imager = make_imager(skin, solver, gains)
    warm_up(skin, imager)
    with closing(of.join(skin, "reconstructor", pulse)) as fabric:
        pulse.fabric = fabric
        service = ReconstructorService(skin, imager, fabric, instance=fabric.instance, clock_ns=fabric.clock().now_ns)
        say("reconstructor", f"{skin.taxels.words}, {imager.about}")
        service.schedule(fabric.tell_scheduling)
        service.run(stop, pulse.beat)
