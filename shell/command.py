"""The ``skin`` command: a table of verbs; the code of a verb is loaded when the verb is called."""

import ast
import gc
import inspect
import logging
import os
import signal
import sys
import textwrap
from collections.abc import Sequence
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, get_args, get_origin

from canskin.errors import InputError, RunError, SkinError, Stopped
from canskin.keys import ENVIRONMENT
from shell.service import REAL_TIME_RATIO, Priority, Talk, set_priority, set_talk

if TYPE_CHECKING:
    import cyclopts

FAILED: Final = 1
WRONG_INPUT: Final = 2
#: 128 + number of SIGINT or SIGTERM, as in shells.
INTERRUPTED: Final = 130
TERMINATED: Final = 143

#: Verb, or group and verb: module and function. Strings, because this folder imports no other folder.
VERBS: Final = {
    "demo": "demo.command:demo",
    "run": "shell.run_command:run",
    "bus": "bus.command:bus",
    "nodes": "nodes.command:nodes",
    "gateway": "gateway.command:gateway",
    "hub": "hub.hub_command:hub",
    "scan": "commissioning.scan_command:scan",
    "commission": "commissioning.commission_command:commission",
    "node check": "commissioning.node_check_command:check",
    "node objects": "commissioning.node_objects_command:objects",
    "node get": "commissioning.node_objects_command:get",
    "node set": "commissioning.node_objects_command:set_",
    "node reset": "commissioning.node_orders_command:reset",
    "node stop": "commissioning.node_orders_command:stop",
    "node start": "commissioning.node_orders_command:start",
    "node update": "commissioning.program_update_command:update",
    "tare": "calibration.command:tare",
    "calibration": "calibration.command:calibration",
    "reconstruct": "reconstructor.command:reconstruct",
    "classify": "classifier.command:classify",
    "list": "health.list_command:list_",
    "view": "views.page.command:view",
    "monitor": "views.monitor.command:monitor",
    "ros2": "views.ros2.command:ros2",
    "show": "views.show.command:show",
    "metrics": "views.metrics.command:metrics",
    "record": "recording.record_command:record",
    "replay": "recording.replay_command:replay",
    "label": "recording.label_command:label",
    "export": "recording.export_command:export",
    "contract": "nodes.contract_command:contract",
    "layout": "bandwidth.layout_command:layout",
    "plan": "bandwidth.plan_command:plan",
    "load": "bandwidth.load_command:load",
    "keys new": "hub.keys_command:new",
    "keys add": "hub.keys_command:add",
    "keys renew": "hub.keys_command:renew",
    "keys revoke": "hub.keys_command:revoke",
    "keys list": "hub.keys_command:list_",
    "keys explain": "hub.keys_command:explain",
    "doctor": "commissioning.doctor_command:doctor",
    "touch objects": "touch.command:objects",
    "touch dataset": "touch.datasets.command:dataset",
    "train": "classifier.command:train",
    "evaluate paper": "evaluation.command:paper",
    "evaluate rivals": "evaluation.command:rivals",
    "evaluate recognition": "evaluation.command:recognition",
    "evaluate calibration": "evaluation.command:calibration",
    "evaluate single-wire": "evaluation.command:single_wire",
    "bench": "evaluation.bench.command:bench",
}
#: What the verbs of a group are for.
GROUPS: Final = {
    "keys": "Who may connect to the hub of a robot: an authority, and keys of its own for each program and person.",
    "node": "One board, or all: whether it keeps the contract, its objects and program, NMT commands.",
    "evaluate": "The paper's tables and figures made again, and what goes beyond them.",
    "touch": "The objects that can touch a simulated skin, and the data sets that their touches make.",
}
_PRIORITY: Final = (
    f"Scheduling of services. auto: real time while all programs with real time take at most {REAL_TIME_RATIO:.0%} of"
    " the cores. realtime: always. normal: never."
)
HELP_FLAGS: Final = ("--help", "-h")


def build_app(arguments: Sequence[str] = ()) -> "cyclopts.App":
    """Return the command line with every verb, and with the help texts that `arguments` need.

    Options of the whole command (``--verbose``, ``--quiet``, ``--log-json``) are those of `cyclopts.App.meta`, which
    passes all other arguments to the verb: call ``build_app(...).meta(arguments)``.
    """
    import cyclopts

    everywhere = cyclopts.Group("Of every verb", sort_key=1)
    app = cyclopts.App(
        name="skin",
        help="A robot skin on CAN: sums of taxels from CANopen nodes, tactile images, names of touching objects.",
        version=lambda: version("canskin"),
        version_flags=["--version"],
        # A list takes every value up to the next option; empty defaults are not shown.
        default_parameter=cyclopts.Parameter(
            consume_multiple=(1, None), negative_iterable=(), show_default=_default, converter=_converted
        ),
        result_action="return_value",
        exit_on_error=False,
        print_error=False,
    )
    asks_for_help = bool(set(arguments) & set(HELP_FLAGS))
    words = [word for word in arguments if not word.startswith("-")]
    groups: dict[str, cyclopts.App] = {}
    for place, (verb, where) in enumerate(VERBS.items()):
        *group, name = names = verb.split()
        texts = {}
        if words == group:
            texts["help"] = summary(docstring(where))
        elif asks_for_help and words[: len(names)] == names:
            texts["help_epilogue"] = examples(docstring(where))
        for each in group:
            if each not in groups:
                groups[each] = cyclopts.App(name=each, help=GROUPS[each], sort_key=place)
                app.command(groups[each])
        (groups[group[0]] if group else app).command(where, name=name, sort_key=place, **texts)
    app.register_install_completion_command(help="Install completion for bash, zsh or fish.")

    @app.meta.default
    def launch(
        *tokens: Annotated[str, cyclopts.Parameter(show=False, allow_leading_hyphen=True, converter=cyclopts.convert)],
        verbose: Annotated[bool, cyclopts.Parameter(alias="-v", group=everywhere, negative=())] = False,
        quiet: Annotated[bool, cyclopts.Parameter(alias="-q", group=everywhere, negative=())] = False,
        log_json: Annotated[bool, cyclopts.Parameter(group=everywhere, negative=())] = False,
        priority: Annotated[Priority, cyclopts.Parameter(group=everywhere, help=_PRIORITY)] = Priority.AUTO,
        keys: Annotated[Path | None, cyclopts.Parameter(group=everywhere)] = None,
    ) -> object:
        """Run a verb.

        Parameters
        ----------
        verbose
            Write more to stderr: every repeated warning, services that come and go, the log of the libraries.
        quiet
            Write errors only to stderr.
        log_json
            Write stderr as JSON, one object per line.
        keys
            Folder of keys, which ``skin keys`` makes, for a hub at ``tls/HOST:PORT``; default: SKIN_KEYS.
        """
        if verbose and quiet:
            raise InputError("expected --verbose or --quiet, got both")
        set_talk(Talk.VERBOSE if verbose else Talk.QUIET if quiet else Talk.NORMAL, as_json=log_json)
        set_priority(priority)
        if keys is not None:  # of every connection of this process and of those that it starts
            os.environ[ENVIRONMENT] = str(keys.absolute())
        if verbose:
            logging.basicConfig(level=logging.INFO, format="%(name)s: %(message)s")
        command, bound, _ = app.parse_args(tokens)  # loads the verb's code
        gc.freeze()
        gc.enable()
        return command(*bound.args, **bound.kwargs)

    return app


def docstring(where: str) -> str:
    """Return the docstring of the function at ``module:function``, empty without docstring.

    The source is read: importing every folder for a list of verbs would take seconds.
    """
    module, _, name = where.partition(":")
    spec = find_spec(module)
    if spec is None or spec.origin is None:
        return ""
    tree = ast.parse(Path(spec.origin).read_text(encoding="utf-8"))
    found = [node for node in tree.body if isinstance(node, ast.FunctionDef) and node.name == name]
    return ast.get_docstring(found[0]) or "" if found else ""


def summary(text: str) -> str:
    """Return the first line of a docstring."""
    return text.partition("\n")[0]


def examples(text: str) -> str:
    """Return the Examples section of a NumPy docstring as Markdown, one line per example; empty without section."""
    _, heading, section = inspect.cleandoc(text).partition("Examples\n--------\n")
    lines = textwrap.dedent(section).strip().splitlines()
    # No code block: empty lines would be shown around the block.
    return "\\\n".join(["Examples:", *(f"`{line}`" for line in lines if line)]) if heading else ""


def _converted(hint: Any, tokens: Sequence["cyclopts.Token"]) -> object:
    """Convert the words of an option. cyclopts would take no text for a value, and round a fraction."""
    import cyclopts

    for token in tokens:
        name = f"{token.keyword}: " if token.keyword else ""
        if token.implicit_value is cyclopts.UNSET and not token.value.strip():
            raise InputError(f"{name}expected a value, got an empty text, as of a shell's variable that is not set")
        if int in (hint, *get_args(hint)) and "." in token.value:
            raise InputError(f"{name}expected a whole number, got '{token.value}'")
    return cyclopts.convert(hint, tokens)


def _default(value: object) -> str | None:
    """Return the text of a default in the help; None for flags and empty defaults."""
    return None if value is None or isinstance(value, bool) or value in ("", [], ()) else str(value)


def main() -> None:
    """Run one verb; exit code 0: success, 1: the run failed, 2: wrong input."""
    # SIGTERM then ends a verb and its processes as Ctrl-C does; services handle both signals themselves.
    signal.signal(signal.SIGTERM, _terminated)
    try:
        sys.exit(_run(sys.argv[1:]))
    except KeyboardInterrupt:  # also while libraries are loaded, which takes longest
        sys.exit(INTERRUPTED)


def _terminated(_number: int, _frame: FrameType | None) -> None:
    raise SystemExit(TERMINATED)


def _run(arguments: Sequence[str]) -> int:
    gc.disable()  # what is loaded stays: the search for garbage would take a sixth of the time
    import cyclopts

    try:
        status = build_app(arguments).meta(arguments)
        sys.stdout.flush()
    except RunError as error:
        return _complain(error, FAILED)
    except (SkinError, cyclopts.CycloptsError, MemoryError) as error:
        return _complain(_in_words(error), WRONG_INPUT)
    except Stopped:
        return 0
    except BrokenPipeError:
        sys.stderr.close()  # else Python reports the same error again
        return FAILED
    except OSError as error:  # for example a full disk
        sys.stdout = None  # its buffer cannot be written at exit either
        return _complain(error, FAILED)
    return status if isinstance(status, int) else 0


def _in_words(error: "SkinError | cyclopts.CycloptsError | MemoryError") -> Exception | str:
    """Tell what a verb takes where a word is one too many, or its first word is missing."""
    import cyclopts

    if isinstance(error, MemoryError):
        return f"the memory of this machine is too small for that: expected smaller numbers: {error}"
    if isinstance(error, SkinError):
        return error
    verb = " ".join(error.command_chain or ())
    if isinstance(error, cyclopts.UnusedCliTokensError):
        return f"{verb}: nothing takes {' '.join(error.unused_tokens or ())}; 'skin {verb} --help' explains"
    argument = error.argument
    if isinstance(error, cyclopts.MissingArgumentError) and argument is not None and not error.keyword:
        choices = get_args(argument.hint)
        expected = " or ".join(map(str, choices)) if get_origin(argument.hint) is Literal else argument.name.lstrip("-")
        return f"{verb}: expected {expected}; 'skin {verb} --help' explains"
    return error


def _complain(error: Exception | str, status: int) -> int:
    """Print an error as one line and return `status`."""
    print(f"skin: {' '.join(str(error).split())}", file=sys.stderr)
    return status
