"""What the programs of boards take, against the limits that ``docs/firmware.md`` tells a maker."""

import re
from pathlib import Path
from typing import Final

from tests.mcu.build import BOARDS
from tests.mcu.machine import Machine

_DOCUMENT: Final = Path(__file__).parents[2] / "docs/firmware.md"
_ROW: Final = r"\| {} \| ([\d.]+) kB \| ([\d.]+) kB \| ([\d.]+) kB \|"
#: Least part of a limit that is used: a limit far above tells nobody anything.
_LEAST_RATIO: Final = 0.75
#: The table that the tests have made.
TABLE: Final[list[str]] = []


def check_sizes(machine: Machine, kind: str) -> None:
    """Compare flash memory, RAM and stack of the boards of a machine with the limits of the document."""
    row = re.search(_ROW.format(re.escape(kind)), _DOCUMENT.read_text())
    assert row, f"{_DOCUMENT}: no row of '{kind}'"
    sizes = (*machine.images.sizes(), max(machine.stack_bytes(cpu) for cpu in range(1, BOARDS + 1)))
    TABLE.append(
        f"{kind}: flash {sizes[0]}, RAM {sizes[1]}, stack {sizes[2]} bytes; limits {', '.join(row.groups())} kB"
    )
    for used, limit in zip(sizes, row.groups(), strict=True):
        assert _LEAST_RATIO * float(limit) <= used / 1000 <= float(limit), TABLE[-1]
