"""The ``skin`` command: one table of verbs, each loaded only when it is called."""

import signal
import sys
from collections.abc import Sequence
from importlib.metadata import version
from types import FrameType
from typing import TYPE_CHECKING, Final

from skin.errors import RunError, SkinError
from skin.explain import docstring, examples, summary
from skin.service import Stopped

if TYPE_CHECKING:
    import cyclopts

FAILED: Final = 1
WRONG_INPUT: Final = 2
#: 128 and SIGINT or SIGTERM, as shells have it.
INTERRUPTED: Final = 130
TERMINATED: Final = 143

#: Verb: where its function lives. Strings, so that this room imports none of the others.
VERBS: Final = {
    "demo": "demo.command:demo",
    "bus": "bus.command:bus",
    "nodes": "nodes.command:nodes",
    "gateway": "gateway.command:gateway",
    "reconstruct": "reconstructor.command:reconstruct",
    "classify": "classifier.command:classify",
    "view": "viewer.command:view",
    "dbc": "dbc.command:dbc",
    "plan": "bandwidth.plan_command:plan",
    "load": "bandwidth.load_command:load",
    "objects": "touch.command:objects",
    "dataset": "touch.datasets.command:dataset",
    "train": "classifier.command:train",
    "evaluate": "evaluation.command:evaluate",
    "bench": "evaluation.bench.command:bench",
}


HELP_FLAGS: Final = ("--help", "-h")


def build_app(arguments: Sequence[str] = ()) -> "cyclopts.App":
    """Return the command line with every verb registered, and with the help texts that `arguments` ask for."""
    import cyclopts

    app = cyclopts.App(
        name="skin",
        help="A distributed robot skin on CAN: sums from CANopen nodes, images by FISTA, objects by name.",
        version=lambda: version("canskin"),
        version_flags=["--version"],
    )
    lists_verbs = not arguments or arguments[0] in HELP_FLAGS
    for place, (verb, where) in enumerate(VERBS.items()):
        texts = {}
        if lists_verbs:
            texts["help"] = summary(docstring(where))
        elif arguments[0] == verb and set(arguments) & set(HELP_FLAGS):
            texts["help_epilogue"] = examples(docstring(where))
        app.command(where, name=verb, sort_key=place, **texts)
    return app


def main() -> None:
    """Run one verb; 0 is success, 1 a run that failed, 2 a wrong input."""
    # What a verb has begun, processes included, is then ended as after Ctrl-C; services take both signals themselves.
    signal.signal(signal.SIGTERM, _terminated)
    try:
        sys.exit(_run(sys.argv[1:]))
    except KeyboardInterrupt:  # also while libraries are being loaded, which takes longer than this module
        sys.exit(INTERRUPTED)


def _terminated(_number: int, _frame: FrameType | None) -> None:
    raise SystemExit(TERMINATED)


def _run(arguments: Sequence[str]) -> int:
    import cyclopts

    try:
        status = build_app(arguments)(exit_on_error=False, print_error=False)
        sys.stdout.flush()
    except RunError as error:
        return _complain(error, FAILED)
    except (SkinError, cyclopts.CycloptsError) as error:
        return _complain(error, WRONG_INPUT)
    except Stopped:
        return 0
    except BrokenPipeError:
        sys.stderr.close()  # where Python would complain of the same once more
        return FAILED
    except OSError as error:  # a full disk behind standard output, for one
        sys.stdout = None  # what it still holds cannot be written at the end either
        return _complain(error, FAILED)
    return status if isinstance(status, int) else 0


def _complain(error: Exception, status: int) -> int:
    """Print an error as one line and return `status`."""
    print(f"skin: {' '.join(str(error).split())}", file=sys.stderr)
    return status
