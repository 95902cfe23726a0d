"""``skin demo``: the whole chain on this machine, without hardware, root or a running service."""

import sys

from canskin.errors import RunError
from demo.options import DEFAULTS, DemoOptions
from shell.service import StopSignal, say
from shell.terminal import Json, print_json, print_table


def demo(*, options: DemoOptions = DEFAULTS, json: Json = False) -> int:
    """Press and slide objects on a skin and show the whole chain at work.

    Starts nodes with virtual buses, gateway, reconstructor, classifier and web page as separate processes, runs for a
    while, and ends with a summary and a picture.

    Parameters
    ----------
    options
        What runs.
    json
        Print the figures of the run as one JSON object on stdout.

    Examples
    --------
    skin demo --seconds 10 --objects golf-ball
    skin demo --seconds 60 --objects paper
    skin demo --solver paper
    skin demo --defect dead=0.05 stuck=0.02
    skin demo --objects cup.stl@mm --no-classify
    skin demo --objects cup.stl@mm --model mine.npz
    skin demo --drift patch12:ramp:0.003:10:60
    skin demo --input S1.npz --array posture_01 posture_02 --full-scale 4095 --json
    """
    stop = StopSignal().install()
    # Imported here, because these imports take seconds in which signals must be handled.
    from demo.folder import run_folder
    from demo.run import Run
    from skin.choice import chosen
    from skin.layout import layout_tables, load_layout, require_boards

    skin = load_layout(options.layout)
    require_boards(skin)
    options.check(skin)
    for words in chosen(skin, layout_tables(options.layout)[0]):
        say("demo", words)
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
        print_table((), (saved or report).rows())
    sys.stdout.flush()
    if report.failure:
        raise RunError(report.failure)
    return int(saved is None)
