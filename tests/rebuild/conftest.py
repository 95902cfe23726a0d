"""A small skin on two buses, a touch that moves over it, and what its buses carry."""

from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest

from dbc.canopen import SYNC_COB_ID
from dbc.codec import encode
from dbc.contract import Contract
from nodes.electronics import Electronics
from tests.layouts import buses, layout_toml, small_layout

SMALL: dict[str, Any] = {
    "name": "small",
    "measurement": {"block_size": 16, "sums": 128},
    "sync": {"identity": "alternating"},
    "bus": buses(8, 8, names=("left", "right")),
}
CYCLES = 12
START_S = 1_700_000_000.0


@pytest.fixture(scope="session")
def contract() -> Contract:
    return Contract.from_layout(small_layout(16, 16, **SMALL))


@pytest.fixture
def layout_file(tmp_path: Path) -> Path:
    path = tmp_path / "small.toml"
    path.write_text(layout_toml(16, 16, **SMALL))
    return path


@pytest.fixture(scope="session")
def force_n() -> np.ndarray:
    """A bump of 10 mN that wanders, shape (cycles, 16, 16)."""
    k, i, j = np.indices((CYCLES, 16, 16))
    return (0.01 * np.exp(-((i - 6 - k / 5) ** 2 + (j - 8) ** 2) / 6)).astype(np.float32)


@pytest.fixture(scope="session")
def sums(contract: Contract, force_n: np.ndarray) -> np.ndarray:
    """What the nodes measure, counts, shape (cycles, m)."""
    electronics = Electronics(contract.layout.taxels, noise_n=0.0)
    return np.stack([contract.phi.forward(electronics.read(each)) for each in force_n]).astype(np.int32)


def messages(contract: Contract, sums: np.ndarray) -> list[can.Message]:
    """Return the frames of all buses in the order of time: every SYNC, then its TPDOs."""
    table, sent = contract.table, []
    for cycle, each in enumerate(sums):
        counter, start_s = (237 + cycle) % 240 + 1, START_S + 0.01 * cycle
        rows = np.flatnonzero(table.phase == contract.phase_of(counter))
        sync = bytes([counter]) if contract.sync_overflow else b""
        payloads = encode(each, table.gather[rows], contract.packing)
        for number, bus in enumerate(contract.layout.bus):
            sent.append(message(start_s + 1e-5 * number, SYNC_COB_ID, sync, bus.name))
        for place, row in enumerate(rows):
            bus = contract.layout.bus[table.bus[row]]
            payload = payloads[place, : table.length[row]].tobytes()
            sent.append(message(start_s + 1e-3 + 1e-5 * place, int(table.cob_id[row]), payload, bus.name))
    return sent


def message(time_s: float, cob_id: int, data: bytes, channel: str) -> can.Message:
    return can.Message(timestamp=time_s, arbitration_id=cob_id, data=data, channel=channel, is_extended_id=False)


def write_log(path: Path, sent: list[can.Message]) -> Path:
    with can.Logger(path) as log:
        for each in sent:
            log(each)
    return path
