"""Measurements tell their kind; those of earlier versions, which tell none, are read as well."""

from typing import Any

import msgspec
import pytest

from canskin.errors import UNDECODABLE
from canskin.messages import CONTACTS, MEASUREMENT, CycleMeasurement, SteppedMeasurement
from tests import messages as make

SHARED: dict[str, Any] = {
    "cycle": 1,
    "sync_counter": 2,
    "sampled_mono_ns": 3,
    "sums": bytes(4),
    "valid": b"\1",
    "fingerprint": "0" * 16,
}
HELD: dict[str, Any] = {"known": b"\1", "states": b"\3", "since_ns": bytes(8), "noise_n": 1e-3}
CYCLE, STEPPED = CycleMeasurement(sent_mono_ns=4, **SHARED), SteppedMeasurement(**SHARED, **HELD)


@pytest.mark.parametrize("message", [CYCLE, STEPPED])
def test_a_measurement_of_each_kind_is_read(message: msgspec.Struct) -> None:
    assert MEASUREMENT.decoder()(msgspec.msgpack.encode(message)) == message


def test_a_measurement_of_an_earlier_version_is_read() -> None:
    decode, nothing = MEASUREMENT.decoder(), {"known": b"", "states": b"", "since_ns": b"", "noise_n": 0.0}
    assert decode(msgspec.msgpack.encode({**SHARED, **nothing, "sent_mono_ns": 4})) == CYCLE
    assert decode(msgspec.msgpack.encode({**SHARED, **HELD, "sent_mono_ns": 0})) == STEPPED


@pytest.mark.parametrize(
    "content", [1, [], {}, {1: 2}, {**SHARED, "cycle": "x"}, {**SHARED, "known": b"1"}, {**SHARED, "sending": "often"}]
)
def test_what_is_no_measurement_is_refused(content: object) -> None:
    with pytest.raises(UNDECODABLE):
        MEASUREMENT.decoder()(msgspec.msgpack.encode(content))


def test_a_contact_of_an_earlier_version_has_no_position() -> None:
    now = make.contact(position_m=(1.0, 2.0, 3.0), normal=(1.0, 0.0, 0.0))
    told = msgspec.to_builtins(make.contacts(1, now))
    assert CONTACTS.decoder()(msgspec.msgpack.encode(told)).contacts == [now]
    del told["contacts"][0]["position_m"], told["contacts"][0]["normal"]
    (found,) = CONTACTS.decoder()(msgspec.msgpack.encode(told)).contacts
    assert (found.position_m, found.normal) == ((0.0, 0.0, 0.0), (0.0, 0.0, -1.0))
