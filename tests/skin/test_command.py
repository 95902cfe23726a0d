"""The command line as a whole: every verb loads, explains itself, and ends its help with two real examples."""

import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

from skin.command import VERBS
from skin.explain import docstring, examples, summary


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


def test_list_of_verbs_and_help_of_one() -> None:
    listed = subprocess.run([sys.executable, "-m", "skin", "--help"], capture_output=True, text=True, check=True).stdout
    places = [listed.index(f"│ {verb} ") for verb in VERBS]
    assert places == sorted(places)
    command = [sys.executable, "-m", "skin", "demo", "--help"]
    shown = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    lines = [line.rstrip() for line in shown.split("Examples:")[1].splitlines()]
    assert lines[:2] == ["", "skin demo --seconds 10 --objects golf-ball"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_behind_the_output_is_one_line() -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "skin", "dbc", "--help"], stdout=full, stderr=subprocess.PIPE, text=True, check=False
        )
    assert done.returncode == 1
    assert done.stderr == "skin: [Errno 28] No space left on device\n"
