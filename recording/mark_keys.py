"""Marks that the keys of the recorder's terminal set: 1 to 9 a label, 0 or the space bar none."""

import os
import select
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Final

#: Keys of labels, in their order; `NO_LABEL` ends a mark.
KEYS: Final = "123456789"
NO_LABEL: Final = "0 "

Poll = Callable[[], None]


def has_keys(terminal: int | None = None) -> bool:
    """Tell whether keys reach this process: its input is a terminal, and it is in the foreground of the terminal.

    A process in the background that reads its terminal, or changes its settings, is stopped (termios(3), SIGTTOU).
    """
    descriptor = _standard_input() if terminal is None else terminal
    try:
        return os.isatty(descriptor) and os.tcgetpgrp(descriptor) == os.getpgrp()
    except (OSError, AttributeError):  # not the terminal of this process, or no Unix
        return False


@contextmanager
def mark_keys(labels: Sequence[str], take: Callable[[str], None], terminal: int | None = None) -> Iterator[Poll]:
    """Give what reads the keys that were pressed, and calls `take` with the label of each.

    Inside the ``with`` the terminal passes each key at once and shows none; Ctrl-C works as before. Without a terminal
    (`has_keys`) no key is read.

    Parameters
    ----------
    labels : sequence of str
        One for each of `KEYS`, from the first.
    terminal : int, optional
        Descriptor of the terminal; default: standard input.
    """
    descriptor = _standard_input() if terminal is None else terminal
    if not has_keys(descriptor):
        yield lambda: None
        return
    import termios
    import tty

    of_key = dict.fromkeys(NO_LABEL, "") | dict(zip(KEYS, labels, strict=False))

    def poll() -> None:
        while has_keys(descriptor) and select.select([descriptor], [], [], 0)[0]:
            pressed = os.read(descriptor, 1).decode("ascii", "replace")
            if not pressed:  # the terminal has gone
                return
            if pressed in of_key:
                take(of_key[pressed])

    before = termios.tcgetattr(descriptor)
    tty.setcbreak(descriptor, termios.TCSANOW)
    try:
        yield poll
    finally:
        if has_keys(descriptor):
            termios.tcsetattr(descriptor, termios.TCSANOW, before)


def _standard_input() -> int:
    """Return the descriptor of the standard input, -1 without."""
    try:
        return sys.stdin.fileno()
    except (AttributeError, OSError, ValueError):
        return -1
