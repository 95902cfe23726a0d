"""``skin demo``: the whole chain on this machine, without hardware, root or a running service."""

import sys
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from canskin.errors import RunError
from skin.recording_options import ArrayNames, FrameRate, FullScale
from skin.service import StopSignal, say
from skin.sources import StrokeKind, object_names
from skin.terminal import Json, print_json


def demo(
    *,
    layout: Path | None = None,
    seconds: float = 20.0,
    input: Path | None = None,  # noqa: A002 - the flag's name
    full_scale: FullScale = None,
    array: ArrayNames = None,
    rate: FrameRate = None,
    objects: list[str] | None = None,
    stroke: StrokeKind = "slide",
    defect: list[str] | None = None,
    drift: list[str] | None = None,
    seed: int = 0,
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
    input
        A recording to play in place of the simulator: .npz, .npy or .csv of shape (time, rows, columns), or .mcap.
    objects
        Names of the objects, see ``skin objects``; ``paper`` for the paper's sixteen; default: a series of five.
    stroke
        ``slide`` or ``press``, see ``skin nodes``; the classifier is trained on the same touches.
    defect
        Defects of the taxels, each KIND or KIND=AMOUNT, see ``skin nodes``: dead, stuck, saturated, noisy, gain-spread,
        offset, cross-talk, drift, damper, creep; analogue front end: mismatch, sum-offset, sum-noise, skew. With an
        offset or drift the touches begin when the zero has been measured.
    drift
        Drifts of zero at a place, each PLACE:COURSE:AMOUNT_N[:START_S[:DURATION_S]], see ``skin nodes``; START_S counts
        from the first SYNC. The touches begin when the zero has been measured.
    seed
        Seed of the touches, of the sensor noise, and of the choice of defective taxels.
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
        recording=input,
        full_scale=full_scale,
        arrays=tuple(array or ()),
        rate_hz=rate,
        objects=object_names(objects or ()),
        stroke=stroke,
        defects=tuple(defect or ()),
        drifts=tuple(drift or ()),
        seed=seed,
        view=view,
        port=port,
        listen=listen,
        picture=picture,
        firmware=firmware,
    )
    skin = load_layout(layout)
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
