"""``skin demo``: the whole chain on this machine, without hardware, root or a running service."""

import sys

from canskin.errors import InputError, RunError
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
    skin demo --layout hand --layout forearm.toml
    skin demo --defect dead=0.05 stuck=0.02
    skin demo --objects cup.stl@mm --no-classify
    skin demo --objects cup.stl@mm --model mine.npz
    skin demo --drift patch12:ramp:0.003:10:60
    skin demo --input S1.npz --array posture_01 posture_02 --full-scale 4095 --json
    """
    stop = StopSignal().install()
    # Imported here, because these imports take seconds in which signals must be handled.
    from demo.folder import run_folder
    from demo.run import Run, execute
    from skin.choice import chosen
    from skin.layout import layout_tables, load_layout, require_boards

    skins = [load_layout(each) for each in options.layout] or [load_layout()]
    is_alone = len(skins) == 1
    names = [each.name for each in skins]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise InputError(f"--layout: expected skins of different names, got '{twice[0]}' {names.count(twice[0])} times")
    asked = [options] if is_alone else [options.of_skin(place, name) for place, name in enumerate(names)]
    for skin, own in zip(skins, asked, strict=True):
        require_boards(skin)
        own.check(skin)
        for words in chosen(skin, layout_tables(own.layout[0] if own.layout else None)[0]):
            say("demo", words)
    try:
        with run_folder() as folder:
            runs = [
                Run(skin, own, folder if is_alone else folder / skin.name, is_alone=is_alone)
                for skin, own in zip(skins, asked, strict=True)
            ]
            reports = execute(runs, options, folder, stop)
    except KeyboardInterrupt:
        say("demo", "interrupted before the first cycle")
        raise
    saved = [run.save_picture(report) for run, report in zip(runs, reports, strict=True)]
    shown = {name: with_picture or report for name, with_picture, report in zip(names, saved, reports, strict=True)}
    if json:
        print_json(next(iter(shown.values())) if is_alone else shown)
    else:
        for name, report in shown.items():
            print_table((), report.rows(), title="" if is_alone else f"{name}:")
    sys.stdout.flush()
    if failures := [f"{'' if is_alone else f'{name}: '}{each.failure}" for name, each in shown.items() if each.failure]:
        raise RunError("; ".join(failures))
    return int(None in saved)
