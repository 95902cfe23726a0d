"""``skin monitor``: a running skin in a terminal."""

import contextlib
import os
import re
import select
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from functools import partial
from itertools import zip_longest
from typing import Final

from rich.console import Console
from rich.control import Control
from rich.segment import ControlType
from rich.text import Text

from canskin.messages import CONTACTS, GATEWAY, IMAGE, LABEL, NODES, SERVICES
from health.feed import Watched
from health.snapshot import Snapshot
from shell.pulse import PERIOD_S, Pulse
from shell.service import StopSignal, Talk, set_talk
from shell.skin_options import PATIENCE_S, SkinOptions
from skin.layout import require_boards
from views.monitor.drawing import ALIASES, SHOWN, screen, whole

SERVICE: Final = "monitor"
#: What is shown. Truths are left out: of all messages they take most time.
TOPICS: Final = (IMAGE, CONTACTS, LABEL, GATEWAY, NODES, SERVICES)
#: Between two frames.
FRAME_S: Final = 0.1
#: Time in which each service tells of itself twice, so that there are rates.
GATHER_S: Final = 2 * PERIOD_S + 0.5
#: Keys of several bytes, and by how many lines they move: arrows, page up and down.
MOVES: Final = {b"\x1b[A": -1, b"\x1b[B": 1, b"\x1b[5~": -10, b"\x1b[6~": 10}
#: Control-L draws all lines again.
REDRAW: Final = b"\x0c"
#: Of a terminal that does not know its size, and of files.
COLUMNS: Final = 80
LINES: Final = 24

_KEY: Final = re.compile(rb"\x1b\[[\d;]*.|.", re.DOTALL)
_KEY_BYTES: Final = 64


class Display:
    """A terminal, and what its user has chosen to see.

    Parameters
    ----------
    console : Console
        Draws.
    size : callable
        Columns and lines now; 0 where the terminal does not know them.

    Attributes
    ----------
    is_over : bool
        The user has left.
    """

    def __init__(self, console: Console, size: Callable[[], tuple[int, int]]) -> None:
        self.is_over = False
        self._console, self._size = console, size
        self._shown, self._first = "a", 0
        self._drawn: list[Text] = []
        self._drawn_size = 0, 0

    def press(self, keys: bytes) -> None:
        """Do what the user wants: no bytes, or several keys."""
        for key in _KEY.findall(keys):
            name = key.decode("ascii", "replace")
            name = ALIASES.get(name, name)
            if key in MOVES:
                self._first = max(0, self._first + MOVES[key])
            elif name in SHOWN:
                self._shown, self._first = name, 0
            elif name == "q":
                self.is_over = True
            elif key == REDRAW:
                self._drawn = []

    def draw(self, state: Snapshot) -> None:
        """Draw the lines that have changed."""
        columns, height = self._size()
        size = columns or COLUMNS, height or LINES
        if size != self._drawn_size:
            self._drawn_size, self._drawn = size, []
        lines, self._first = screen(state, self._shown, size, self._first)
        with self._console:  # one write
            for place, (line, before) in enumerate(zip_longest(lines, self._drawn[: len(lines)])):
                if line != before:
                    # Erased first: a terminal whose cursor waits behind the last column would erase that.
                    self._console.control(Control.move_to(0, place), Control((ControlType.ERASE_IN_LINE, 2)))
                    self._console.print(line, end="", soft_wrap=True, highlight=False)
        self._drawn = lines


def monitor(*, of: SkinOptions | None = None) -> None:
    """Show a running skin in a terminal: what is wrong, since when and what to do, buses, nodes, services.

    Keys: a all, b buses, n nodes, s services, w or / what is wrong, arrows and page keys move, q quits. Where standard
    output is no terminal, one frame is printed, and nothing of it is cut.

    Parameters
    ----------
    of
        Which skin.

    Examples
    --------
    skin monitor
    skin monitor --connect tcp/10.0.0.5:7447
    """
    of = of or SkinOptions()
    skin = of.find(SERVICE)
    require_boards(skin)
    stop = StopSignal().install()
    pulse = Pulse(stop)
    with closing(of.join(skin, SERVICE, pulse, PATIENCE_S)) as fabric:
        pulse.fabric, watched, console = fabric, Watched(skin, fabric, TOPICS, polled=True), Console()
        if not sys.stdout.isatty() or console.is_dumb_terminal:
            print_once(watched, stop)
            return
        set_talk(Talk.QUIET)  # lines of the log would stand among those drawn: the notices tell the same
        with pressed_keys() as read, console.screen():
            # Not the size that rich tells: variables of the environment may hold an old one.
            display = Display(console, partial(os.get_terminal_size, sys.stdout.fileno()))
            while not (stop.is_set() or display.is_over):
                display.draw(watched.snapshot())
                display.press(read(FRAME_S))
                pulse.beat()


def print_once(watched: Watched, stop: StopSignal) -> None:
    """Print one frame, after the time in which all that is shown has come."""
    end_s = time.monotonic() + GATHER_S
    state = watched.snapshot()
    while time.monotonic() < end_s and not stop.wait(FRAME_S):
        state = watched.snapshot()
    for line in whole(state, COLUMNS):
        print(line.rstrip())


@contextlib.contextmanager
def pressed_keys() -> Iterator[Callable[[float], bytes]]:
    """Give a function that waits for keys, at most a time in seconds; restore the terminal at the end."""
    import termios  # both of Unix alone
    import tty

    keyboard = sys.stdin.fileno()
    before = termios.tcgetattr(keyboard) if os.isatty(keyboard) else None

    def read(timeout_s: float) -> bytes:
        is_pressed = select.select([keyboard] if before else [], [], [], timeout_s)[0]
        return (os.read(keyboard, _KEY_BYTES) or b"q") if is_pressed else b""

    if before:
        tty.setcbreak(keyboard)
    try:
        yield read
    finally:
        if before:
            termios.tcsetattr(keyboard, termios.TCSADRAIN, before)
