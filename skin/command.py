"""The ``skin`` command: one table of verbs, each loaded only when it is called."""

import logging
import signal
import sys
from collections.abc import Sequence
from importlib.metadata import version
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Final

from skin.errors import InputError, RunError, SkinError
from skin.explain import docstring, examples, summary
from skin.service import Stopped, Talk, set_talk

if TYPE_CHECKING:
    import cyclopts

FAILED: Final = 1
WRONG_INPUT: Final = 2
#: 128 and SIGINT or SIGTERM, as shells have it.
INTERRUPTED: Final = 130
TERMINATED: Final = 143

#: Verb: where its function lives. Strings, so that this folder imports none of the others.
VERBS: Final = {
    "demo": "demo.command:demo",
    "bus": "bus.command:bus",
    "nodes": "nodes.command:nodes",
    "gateway": "gateway.command:gateway",
    "reconstruct": "reconstructor.command:reconstruct",
    "classify": "classifier.command:classify",
    "view": "viewer.command:view",
    "rebuild": "rebuild.command:rebuild",
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
    """Return the command line with every verb registered, and with the help texts that `arguments` ask for.

    Options of the whole command (``--verbose``, ``--quiet``, ``--log-json``) are those of `cyclopts.App.meta`, which
    hands everything else to the verb: call ``build_app(...).meta(arguments)``.
    """
    import cyclopts

    everywhere = cyclopts.Group("Of every verb", sort_key=1)
    app = cyclopts.App(
        name="skin",
        help="A distributed robot skin on CAN: sums from CANopen nodes, images by FISTA, objects by name.",
        version=lambda: version("canskin"),
        version_flags=["--version"],
        # A list takes every value up to the next option; a default that says nothing is not shown.
        default_parameter=cyclopts.Parameter(consume_multiple=(1, None), negative_iterable=(), show_default=_default),
        result_action="return_value",
        exit_on_error=False,
        print_error=False,
    )
    asks_for_help = bool(set(arguments) & set(HELP_FLAGS))
    verbs = [word for word in arguments if not word.startswith("-")]
    for place, (verb, where) in enumerate(VERBS.items()):
        texts = {}
        if not verbs:
            texts["help"] = summary(docstring(where))
        elif asks_for_help and verbs[0] == verb:
            texts["help_epilogue"] = examples(docstring(where))
        app.command(where, name=verb, sort_key=place, **texts)
    app.register_install_completion_command(help="Install completion for bash, zsh or fish.")

    @app.meta.default
    def launch(
        *tokens: Annotated[str, cyclopts.Parameter(show=False, allow_leading_hyphen=True)],
        verbose: Annotated[bool, cyclopts.Parameter(alias="-v", group=everywhere, negative=())] = False,
        quiet: Annotated[bool, cyclopts.Parameter(alias="-q", group=everywhere, negative=())] = False,
        log_json: Annotated[bool, cyclopts.Parameter(group=everywhere, negative=())] = False,
    ) -> object:
        """Run a verb.

        Parameters
        ----------
        verbose
            Say more on stderr: every repeated warning, who joins and leaves, the log of the libraries.
        quiet
            Say nothing on stderr but errors.
        log_json
            Say what is said on stderr as JSON, one object a line.
        """
        if verbose and quiet:
            raise InputError("expected --verbose or --quiet, got both")
        set_talk(Talk.VERBOSE if verbose else Talk.QUIET if quiet else Talk.NORMAL, as_json=log_json)
        if verbose:
            logging.basicConfig(level=logging.INFO, format="%(name)s: %(message)s")
        return app(tokens)

    return app


def _default(value: object) -> str | None:
    """Return how the help shows a default; None for one that says nothing: a flag's, or an empty one."""
    return None if value is None or isinstance(value, bool) or value in ("", [], ()) else str(value)


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
        status = build_app(arguments).meta(arguments)
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
