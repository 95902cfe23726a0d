"""Tests of boards on emulated processors. `tests/mcu/run` gives them QEMU; other runs leave them out and say so."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import pytest

from dbc.contract import Contract
from skin.layout import layout_text
from tests.layouts import STEPPED, buses, small_layout
from tests.mcu.build import BOARDS, Images, build
from tests.mcu.machine import Machine
from tests.mcu.sizes import TABLE

GIVEN: Final = "SKIN_MCU" in os.environ
#: So slow that a busy machine keeps it.
RATE: Final = {"rate_hz": 5.0}
PATCH: Final[dict[str, Any]] = STEPPED | {"measurement": {"wiring": "board", "block_size": 32}}
BUSES: Final[dict[str, Any]] = {
    "classic": {"bus": buses(BOARDS)},
    "fd": {"bus": buses(BOARDS, blocks_per_node=4, fd=True, data_bitrate=5_000_000)},
}
LAYOUTS: Final = {
    "classic": small_layout(8, 12, name="mcu", sync=RATE, **BUSES["classic"]),
    "fd": small_layout(16, 24, name="mcu", sync=RATE, **BUSES["fd"]),
    "steps": small_layout(8, 12, name="mcu", **PATCH, **BUSES["classic"]),
}

collect_ignore_glob = [] if GIVEN else ["test_*.py"]


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    for line in TABLE:
        terminalreporter.write_line(line)
    if not GIVEN:
        terminalreporter.write_line("not run: the tests on emulated boards; `make test-mcu` runs them", yellow=True)


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Images]:
    """Programs of all kinds of boards; their layouts are ``layout.toml`` beside them."""
    found = {}
    for name, layout in LAYOUTS.items():
        folder = tmp_path_factory.mktemp(name)
        folder.joinpath("layout.toml").write_text(layout_text(layout))
        found[name] = build(Contract.from_layout(layout), folder)
    return found


@pytest.fixture
def machine(built: dict[str, Images], tmp_path: Path) -> Iterator[Machine]:
    """Three boards on classic CAN."""
    with Machine(built["classic"], tmp_path) as running:
        yield running
