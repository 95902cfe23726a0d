"""``skin demo``: the whole chain on this machine, without hardware, root or a running service."""

import sys
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from canskin.errors import RunError
from skin.service import StopSignal, say
from skin.terminal import Json, print_json
from skin.touch_options import NO_TOUCH_OPTIONS, TouchOptions


def demo(
    *,
    layout: Path | None = None,
    seconds: float = 20.0,
    touch: TouchOptions = NO_TOUCH_OPTIONS,
    view: bool = True,
    port: int | None = None,
    listen: str | None = None,
    picture: Annotated[Path, Parameter(name=("--figure", "--picture"))] = Path("skin-demo.png"),
    firmware: Annotated[bool, Parameter(negative=())] = False,
    json: Json = False,
) -> int:
    """Press and slide objects on a skin and show the whole chain at work.

    Starts virtual buses, nodes, gateway, reconstructor, classifier and web page as separate processes, runs for a
    while, and ends with a summary and a picture.

    Parameters
    ----------
    layout
        TOML of the skin; without it the default skin of 64 x 64 taxels on four CAN buses.
    seconds
        Time that SYNC runs, seconds.
    touch
        What touches the skin. With defects that move the zero the touches begin when the zero has been measured.
    view
        ``--no-view`` runs without web page.
    port
        Port of the web page, 0 for a free port; default 8765, or a free port if 8765 is in use.
    listen
        Endpoint of the fabric's hub, to which other programs can connect; default: a free port of this machine.
    picture
        File for the picture of true force, sensor signal, rebuilt image and error.
    firmware
        Run the C firmware of the boards in place of nodes in Python, see ``skin nodes``.
    json
        Print the figures of the run as one JSON object on stdout.

    Examples
    --------
    skin demo --seconds 10 --objects golf-ball
    skin demo --seconds 60 --objects paper
    skin demo --defect dead=0.05 stuck=0.02
    skin demo --drift patch12:ramp:0.003:10:60
    skin demo --input S1.npz --array posture_01 posture_02 --full-scale 4095 --json
    """
    stop = StopSignal().install()
    # Imported here, because these imports take seconds in which signals must be handled.
    from demo.folder import run_folder
    from demo.options import DemoOptions
    from demo.run import Run
    from skin.layout import load_layout

    options = DemoOptions(
        layout_path=layout,
        seconds=seconds,
        touch=touch,
        view=view,
        port=port,
        listen=listen,
        picture=picture,
        firmware=firmware,
    )
    skin = load_layout(layout, adaptive=True)
    options.check(skin)
    try:
        with run_folder() as folder:
            run = Run(skin, options, folder)
            report = run.execute(stop)
    except KeyboardInterrupt:
        say("demo", "interrupted before the first cycle")
        raise
    saved = run.save_picture(report)
    if json:
        print_json(saved or report)
    else:
        run.print_summary(saved or report)
    sys.stdout.flush()
    if report.failure:
        raise RunError(report.failure)
    return int(saved is None)
