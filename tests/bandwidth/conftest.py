"""The command line as a test calls it."""

import sys
from collections.abc import Callable

import pytest

from shell.command import main

Skin = Callable[..., tuple[int, str, str]]


@pytest.fixture
def skin(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Skin:
    def run(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["skin", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
        said = capsys.readouterr()
        return int(ended.value.code or 0), said.out, said.err

    return run
