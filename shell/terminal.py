"""Output of all verbs: tables, progress bars, JSON; their options for another process."""

import io
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields
from typing import TYPE_CHECKING, Annotated, Any, Final

from cyclopts import Parameter

from shell.service import Talk, talks

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

#: Type of the argument ``json`` of a verb: the flag ``--json``, without ``--no-json``.
Json = Annotated[bool, Parameter(name="--json", negative=())]

#: Columns if standard output is no terminal: wider than any table, so no cell is wrapped or cut.
_UNLIMITED: Final = 10_000


def arguments(options: Any) -> list[str]:
    """Return a dataclass of options as text, for another process."""
    given = ((each.name.replace("_", "-"), getattr(options, each.name)) for each in fields(options))
    lists = ((name, value if isinstance(value, list) else [value]) for name, value in given if value is not None)
    return [f"--{name}={each}" for name, values in lists for each in values]


def print_json(document: Any) -> None:
    """Print a document on standard output, as one line of JSON.

    Parameters
    ----------
    document : object
        Anything that `msgspec` encodes (builtins, structs, dataclasses), and NumPy's numbers. Numbers that are not
        finite become ``null``.
    """
    import msgspec

    print(msgspec.json.encode(document, enc_hook=_builtin).decode())


def _builtin(value: Any) -> Any:
    import numpy as np

    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"no JSON for a {type(value).__name__}")


def print_table(headings: Sequence[str], rows: Iterable[Iterable[Any]], *, title: str = "") -> None:
    """Print a table on standard output.

    With headings, columns of numbers are aligned right, except the first column. A narrow terminal wraps cells. If
    standard output is no terminal, the table is plain text with one line per row.

    Parameters
    ----------
    headings : sequence of str
        One heading per column; an empty sequence prints the rows only.
    rows : iterable of iterables
        Cells; ``None`` is shown as an empty cell, anything else by `str`.
    title : str
        A line above the table.
    """
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    cells = [["" if cell is None else str(cell) for cell in row] for row in rows]
    table = Table(box=None, pad_edge=False, show_header=bool(headings))
    columns = headings or [""] * max(map(len, cells), default=0)
    for place, heading in enumerate(columns):
        is_right = bool(headings) and place > 0 and any(_begins_a_number(row[place]) for row in cells)
        # Text, because square brackets in a cell are no markup.
        table.add_column(Text(heading), justify="right" if is_right else "left", overflow="fold")
    for row in cells:
        table.add_row(*map(Text, row))
    if title:
        print(title)
    is_terminal = sys.stdout.isatty()
    console = Console(file=sys.stdout) if is_terminal else Console(file=io.StringIO(), width=_UNLIMITED)
    with console.capture() as capture:
        console.print(table)
    print("\n".join(line.rstrip() for line in capture.get().splitlines()))


def _begins_a_number(cell: str) -> bool:
    return cell.lstrip("+-")[:1].isdigit()


class ProgressBar:
    """The bar of `progress`; without a terminal, only `print` writes."""

    def __init__(self, shown: "Progress", task: "TaskID") -> None:
        self._shown, self._task = shown, task

    def advance(self, steps: float = 1) -> None:
        """Add `steps` to the finished work."""
        self._shown.advance(self._task, steps)

    def update(self, done: float, what: str | None = None) -> None:
        """Set the finished work, and the text if `what` is given."""
        self._shown.update(self._task, completed=done, description=what)

    def print(self, line: str) -> None:
        """Print a line on standard error, above the bar."""
        self._shown.console.print(line, highlight=False, markup=False, soft_wrap=True)


@contextmanager
def progress(what: str, total: float | None, *, done: float = 0) -> Iterator[ProgressBar]:
    """Show the progress of the work inside the ``with``, on standard error if it is a terminal.

    Parameters
    ----------
    what : str
        Text beside the bar.
    total : float, optional
        Size of the work. An int is shown as a count ("3/40"); None, for an unknown end, shows the time since the start.
    done : float
        Part of `total` that is finished before the work begins.

    Yields
    ------
    ProgressBar
    """
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        ProgressColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns: list[ProgressColumn] = [TextColumn("{task.description}", markup=False)]
    if total is None:
        columns.append(TimeElapsedColumn())
    else:
        counted = [MofNCompleteColumn()] if isinstance(total, int) else []
        columns += [BarColumn(), *counted, TimeRemainingColumn()]
    console = Console(stderr=True)
    # A bar without an end is redrawn rarely, to leave the processor to the work.
    with Progress(
        *columns,
        console=console,
        transient=True,
        refresh_per_second=1 if total is None else 10,
        disable=not (console.is_terminal and talks(Talk.NORMAL)),
    ) as shown:
        yield ProgressBar(shown, shown.add_task(what, total=total, completed=done))  # type: ignore[arg-type]
