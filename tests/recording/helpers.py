"""A small skin on two buses, logs of its frames, and links that bring them."""

from pathlib import Path
from typing import Any

import can
import msgspec
import numpy as np
import pytest

from bus.link import State
from canskin.messages import CONTACTS, IMAGE, LABEL, MEASUREMENT, Topic
from dbc.canopen import SYNC_COB_ID
from dbc.codec import encode
from dbc.contract import Contract
from dbc.frame import Frames, frames
from recording.mcap_file import read_entries
from recording.sinks import McapSink
from tests import messages as make
from tests.layouts import buses

#: Tables of the small skin of 16 x 16 taxels.
SMALL: dict[str, Any] = {
    "name": "small",
    "measurement": {"block_size": 16, "sums": 128},
    "encoding": {"sum_bits": 15},  # exact
    "bus": buses(8, 8, names=("left", "right")),
}
CYCLES = 12
START_S = 1_700_000_000.0
#: Wall clock minus CLOCK_MONOTONIC in the tests.
OFFSET_NS = 1_699_999_000_000_000_000
#: Cycles of `write_run`, and the change of the wall clock during cycle 2.
COUNT, SET_NS = 4, 7_000


def messages(contract: Contract, sums: np.ndarray) -> list[can.Message]:
    """Return the frames of all buses in the order of time: every SYNC, then its TPDOs."""
    table, sent = contract.table, []
    for cycle, each in enumerate(sums):
        counter, start_s = (237 + cycle) % 240 + 1, START_S + 0.01 * cycle
        rows = np.flatnonzero(table.turn == contract.turn_of(counter))
        payloads = encode(counter, each, table.gather[rows], contract.packing)
        for number, bus in enumerate(contract.layout.bus):
            sent.append(message(start_s + 1e-5 * number, SYNC_COB_ID, bytes([counter]), bus.name))
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


def pixels(cycle: int) -> np.ndarray:
    return np.arange(256, dtype="<f4").reshape(16, 16) * cycle * 1e-5


def write_run(path: Path, contract: Contract) -> Path:
    """Write a recording of messages alone, those of `write_messages`."""
    sink = McapSink(path, contract, 1, OFFSET_NS)
    write_messages(sink, contract)
    sink.close()
    return path


def write_messages(sink: McapSink, contract: Contract) -> None:
    """Write measurements, images, contacts and labels of `COUNT` cycles."""
    for cycle in range(1, COUNT + 1):
        stamps = {"cycle": cycle, "sync_counter": cycle, "sampled_mono_ns": cycle * 10, "sampled_error_ns": cycle}
        valid = bytes([cycle > 1] * 16)
        centre = {"position_m": (0.01, 0.02, 0.03), "normal": (0.0, 0.6, -0.8)}
        contact = make.contact(identity=3, row=1.5, column=2.5, force_n=0.25, **centre)
        for topic, message in (
            (
                MEASUREMENT,
                make.measurement(
                    **stamps,
                    usable=b"\1" * 5 + b"\0" + b"\1" * (128 - 6) if cycle == 2 else b"",
                    sums=np.full(128, cycle, "<i4").tobytes(),
                    valid=valid,
                    fingerprint=contract.phi.fingerprint,
                    wall_offset_ns=OFFSET_NS + SET_NS * (cycle > 2),
                ),
            ),
            (
                IMAGE,
                make.image(
                    **stamps,
                    pixels=pixels(cycle).tobytes(),
                    valid=valid,
                    valid_sums=7,
                ),
            ),
            (CONTACTS, make.contacts(**stamps, contacts=[contact] * (cycle == 2))),
            (LABEL, make.label(**stamps, confidence=0.5, valid_sums=7)),
        ):
            sink.message(topic, cycle, msgspec.msgpack.encode(message))


def messages_of(path: Path, topic: Topic) -> list[Any]:
    """Return the messages of a topic in a recording."""
    decode = topic.decoder()
    return [decode(entry.data) for entry in read_entries(path, pytest.fail) if entry.topic == topic.name]
