"""A recording of four cycles, and the messages of a recording."""

from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from canskin.messages import CONTACTS, IMAGE, LABEL, MEASUREMENT, Topic
from dbc.contract import Contract
from recording.sinks import McapSink
from skin.mcap_file import read_entries
from tests import messages as make
from tests.recording.conftest import OFFSET_NS

COUNT = 4
#: The wall clock is set by so much during cycle 2.
SET_NS = 7_000


def pixels(cycle: int) -> np.ndarray:
    return np.arange(256, dtype="<f4").reshape(16, 16) * cycle * 1e-5


@pytest.fixture
def run(contract: Contract, out: Path) -> Path:
    sink = McapSink(out, contract, 1, OFFSET_NS)
    for cycle in range(1, COUNT + 1):
        stamps = {"cycle": cycle, "sync_counter": cycle, "sampled_mono_ns": cycle * 10, "sampled_error_ns": cycle}
        valid = bytes([cycle > 1] * 16)
        contact = make.contact(identity=3, row=1.5, column=2.5, force_n=0.25)
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
    sink.close()
    return out


def messages(path: Path, topic: Topic) -> list[Any]:
    decode = msgspec.msgpack.Decoder(topic.message).decode
    return [decode(entry.data) for entry in read_entries(path, pytest.fail) if entry.topic == topic.name]
