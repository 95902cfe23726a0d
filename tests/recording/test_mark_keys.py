"""Keys of the recorder's terminal set marks; without a terminal in the foreground none is read."""

import os
import pty
import termios
from collections.abc import Iterator

import pytest

from recording import mark_keys as keys
from recording.mark_keys import has_keys, mark_keys


@pytest.fixture
def terminal() -> Iterator[tuple[int, int]]:
    """A person's end and the program's end of a terminal."""
    person, program = pty.openpty()
    yield person, program
    os.close(person)
    os.close(program)


@pytest.fixture
def foreground(monkeypatch: pytest.MonkeyPatch) -> None:
    """The terminal of the test is not that of its process: pretend."""
    monkeypatch.setattr(os, "tcgetpgrp", lambda _: os.getpgrp())


@pytest.mark.usefixtures("foreground")
def test_keys_set_labels_end_them_and_others_do_nothing(terminal: tuple[int, int]) -> None:
    person, program = terminal
    before = termios.tcgetattr(program)
    taken: list[str] = []
    with mark_keys(["cup", "ball"], taken.append, program) as poll:
        poll()
        assert taken == []
        os.write(person, b"12x30 1")
        poll()
        assert taken == ["cup", "ball", "", "", "cup"]
        assert termios.tcgetattr(program)[3] & termios.ISIG  # Ctrl-C ends the recorder
    assert termios.tcgetattr(program) == before


@pytest.mark.usefixtures("foreground")
def test_a_terminal_that_has_gone_ends_nothing(terminal: tuple[int, int], monkeypatch: pytest.MonkeyPatch) -> None:
    _, program = terminal
    with mark_keys(["cup"], pytest.fail, program) as poll:
        monkeypatch.setattr(keys.os, "read", lambda *_: b"")
        os.write(terminal[0], b"1")
        poll()


def test_in_the_background_no_key_is_read(terminal: tuple[int, int], monkeypatch: pytest.MonkeyPatch) -> None:
    person, program = terminal
    monkeypatch.setattr(os, "tcgetpgrp", lambda _: os.getpgrp() + 1)
    before = termios.tcgetattr(program)
    with mark_keys(["cup"], pytest.fail, program) as poll:
        os.write(person, b"1\n")
        poll()
        assert termios.tcgetattr(program) == before


def test_a_pipe_has_no_keys() -> None:
    reading, writing = os.pipe()
    assert not has_keys(reading)
    with mark_keys(["cup"], pytest.fail, reading) as poll:
        os.write(writing, b"1")
        poll()
    os.close(reading)
    os.close(writing)
