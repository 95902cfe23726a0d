"""The command line as a whole: every verb loads, explains itself, and ends its help with two real examples."""

import io
import json
import re
import subprocess
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import pytest
from rich.console import Console

from canskin.errors import InputError
from health.causes import Cause
from shell.command import GROUPS, VERBS, build_app, docstring, examples, summary
from shell.service import RateLimitedLog, Talk, say, set_talk
from tests.processes import Verb


def help_of(*arguments: str) -> str:
    console = Console(file=io.StringIO(), width=200)
    build_app(arguments).meta(arguments, console=console)
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


@pytest.fixture
def talk() -> Iterator[None]:
    yield
    set_talk(Talk.NORMAL)


@pytest.mark.parametrize("where", VERBS.values())
def test_verb_loads_and_says_what_it_does(where: str) -> None:
    module, _, name = where.partition(":")
    function = getattr(import_module(module), name)
    assert summary(docstring(where)) == summary(function.__doc__)
    assert summary(docstring(where)).endswith(".")


@pytest.mark.parametrize(("verb", "where"), VERBS.items())
def test_help_ends_with_two_examples(verb: str, where: str) -> None:
    heading, *shown = examples(docstring(where)).split("\\\n")
    assert heading == "Examples:"
    assert len(shown) >= 2
    assert all(line.startswith(f"`skin {verb}") and line.endswith("`") for line in shown)


def test_every_verb_that_a_cause_names_exists() -> None:
    named = [f"{words} " for cause in Cause for words in re.findall("'skin ([^']+)'", cause.mend)]
    assert named
    assert not [words for words in named if not any(words.startswith(f"{verb} ") for verb in VERBS)]


@pytest.mark.heavy
def test_list_of_verbs_and_help_of_one() -> None:
    listed = subprocess.run([sys.executable, "-m", "skin", "--help"], capture_output=True, text=True, check=True).stdout
    places = [listed.index(f"│ {verb} ") for verb in dict.fromkeys(each.split()[0] for each in VERBS)]
    assert places == sorted(places)
    command = [sys.executable, "-m", "skin", "demo", "--help"]
    shown = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    lines = [line.rstrip() for line in shown.split("Examples:")[1].splitlines()]
    assert lines[:2] == ["", "skin demo --seconds 10 --objects golf-ball"]


@pytest.mark.heavy
@pytest.mark.parametrize("group", GROUPS)
def test_a_group_tells_of_its_verbs(group: str) -> None:
    shown = help_of(group, "--help")
    of_group = {verb: where for verb, where in VERBS.items() if verb.startswith(f"{group} ")}
    assert of_group
    for verb, where in of_group.items():
        assert verb.split()[1] in shown
        assert summary(docstring(where))[:60] in shown


@pytest.mark.heavy
@pytest.mark.parametrize("verb", VERBS)
def test_help_shows_no_option_that_nobody_would_write(verb: str) -> None:
    shown = help_of(*verb.split(), "--help")
    nonsense = r"Priority\.|--empty-\S*|--no-no\S*|\[default: (?:\"\"|\[\]|False|None|)\]"
    assert re.findall(nonsense, shown) == []
    assert "--quiet -q" in shown


def test_completion_knows_every_verb_and_its_options() -> None:
    script = build_app().generate_completion(shell="bash")  # noqa: S604 - the name of a shell, none is run
    assert all(f'"{word}"' in script or f" {word}" in script for verb in VERBS for word in verb.split())
    assert "--data-bitrate" in script


@pytest.mark.heavy
@pytest.mark.parametrize(("option", "lines"), [("--quiet", 0), ("-q", 0), ("-v", 8)])
@pytest.mark.usefixtures("talk")
def test_quiet_and_verbose(option: str, lines: int, capsys: pytest.CaptureFixture[str]) -> None:
    build_app([]).meta(["contract", "--check", option])
    capsys.readouterr()
    say("test", "one")
    say("test", "detail", Talk.VERBOSE)
    log = RateLimitedLog("test")
    for _ in range(RateLimitedLog.BURST + 1):
        log.say("again")
    assert len(capsys.readouterr().err.splitlines()) == lines


@pytest.mark.usefixtures("talk")
def test_verbose_and_quiet_contradict_each_other() -> None:
    with pytest.raises(InputError, match="--verbose or --quiet"):
        build_app().meta(["-v", "-q", "view"])


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("layout", "layout: expected new or check or settings or draw; 'skin layout --help' explains"),
        ("bench", "bench: expected reconstruct or gateway or chain or classify; 'skin bench --help' explains"),
        ("replay", "replay: expected source; 'skin replay --help' explains"),
        ("demo cup --no-view", "demo: nothing takes cup; 'skin demo --help' explains"),
        ("layout nothing", 'Invalid value "nothing" for ACTION'),
        ("nothing", 'Unknown command "nothing"'),
        ("tare --region", "requires an argument"),
    ],
)
def test_a_wrong_word_is_one_line_and_exit_code_2(words: str, said: str, skin: Verb) -> None:
    code, _, told = skin(*words.split())
    (line,) = told.splitlines()
    assert (code, said in line) == (2, True)


@pytest.mark.usefixtures("talk")
def test_log_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    set_talk(Talk.NORMAL, as_json=True)
    say("gateway", "4 buses")
    line = json.loads(capsys.readouterr().err)
    assert (line["service"], line["text"]) == ("gateway", "4 buses")


@pytest.mark.heavy
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="NOT TESTED: a full disk, for want of /dev/full")
def test_a_full_disk_behind_the_output_is_one_line() -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "skin", "contract", "--help"],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert done.returncode == 1
    assert done.stderr == "skin: [Errno 28] No space left on device\n"
