"""The commands of docs/rerun-foxglove.md."""

import shlex
from pathlib import Path

import pytest

from shell.command import build_app

COMMANDS = [
    shlex.split(line.strip(), comments=True)[1:]
    for line in Path("docs/rerun-foxglove.md").read_text().splitlines()
    if line.startswith("    skin ")
]


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_the_verb_takes_the_arguments(command: list[str]) -> None:
    _, bound, ignored = build_app(command).parse_args(command)[:3]
    assert bound.arguments
    assert not ignored


def test_the_page_has_commands() -> None:
    assert len(COMMANDS) == 8
