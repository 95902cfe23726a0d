"""A small skin on two buses, logs of its frames, and links that bring them."""

from pathlib import Path

import can
import numpy as np

from bus.link import State
from dbc.canopen import SYNC_COB_ID
from dbc.codec import encode
from dbc.contract import Contract
from dbc.frame import Frames, frames

LAYOUT = b"""
name = "small"
[taxels]
rows = 16
columns = 16
[measurement]
block_size = 16
sums = 128
[sync]
identity = "alternating"
[[bus]]
name = "left"
nodes = 8
[[bus]]
name = "right"
nodes = 8
"""
CYCLES = 12
START_S = 1_700_000_000.0
#: Wall clock minus CLOCK_MONOTONIC in the tests.
OFFSET_NS = 1_699_999_000_000_000_000


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


class FakeLink:
    """A link that brings what is put into `coming`."""

    def __init__(self) -> None:
        self.coming: list[Frames] = []
        self.state = State.ACTIVE
        self.dropped = 0
        self.sent: list[Frames] = []

    def fileno(self) -> int:
        raise AssertionError("a recorder does not wait for frames")

    def receive(self) -> Frames:
        return self.coming.pop(0) if self.coming else frames(0)

    def send(self, burst: Frames) -> int:
        raise AssertionError("a recorder sends nothing")

    def close(self) -> None:
        """Nothing to leave."""
