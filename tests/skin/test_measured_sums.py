"""A measurement is decoded when it fits Φ; what does not fit is refused with a reason, and named once in a while."""

import msgspec
import numpy as np
import pytest

from canskin.errors import InputError
from canskin.messages import Measurement, SteppedMeasurement
from canskin.sums import doubtful_taxels
from skin import measured_sums
from skin.measured_sums import MeasurementReader, decode_measurement, decode_stepped
from skin.phi import sbhe
from tests import messages as make

PHI = sbhe(64, 16, block_size=8)
SUMS = np.arange(-8, 8, dtype="<i4")
GOOD = make.measurement(
    sampled_mono_ns=1,
    sums=SUMS.tobytes(),
    valid=bytes([1, 0, 1, 1, 1, 1, 1, 1]),
    fingerprint=PHI.fingerprint,
)
STEPPED = SteppedMeasurement(
    **{name: getattr(GOOD, name) for name in Measurement.__struct_fields__},
    known=bytes([1, 1, 0, *[1] * 13]),
    states=bytes([3, 1, 2, 2, 2, 2, 2, 2]),
    since_ns=np.arange(8, dtype="<i8").tobytes(),
    noise_n=1e-3,
)
BAD = (
    ({"fingerprint": "0" * 16}, f"measured with Φ '0000000000000000', expected {PHI.fingerprint}"),
    ({"fingerprint": "\x1b[2J" * 1000}, r"measured with Φ '\\x1b\[2J"),
    ({"sums": GOOD.sums[:-1]}, "sums of 63 bytes, expected 64"),
    ({"valid": GOOD.valid + b"\1"}, "valid of 9 bytes, expected 8"),
    ({"sums": b"", "valid": b""}, "sums of 0 bytes"),
    ({"offsets": b"\0"}, "offsets of 1 bytes, expected 64, or none"),
    ({"offsets": np.full(16, -(2**31), "<i4").tobytes()}, "sums less offsets beyond 2147483647 counts"),
    ({"usable": b"\0"}, "usable of 1 bytes, expected 16, or none"),
    ({"doubtful": b"\0"}, "doubtful of 1 bytes, expected 8, or none"),
)


def test_sums_and_validity() -> None:
    counts, valid, valid_sums, _ = decode_measurement(GOOD, PHI)
    assert counts.dtype == np.int32
    np.testing.assert_array_equal(counts, np.where(valid_sums, SUMS, 0))
    assert valid.tolist() == [True, False, True, True, True, True, True, True]
    np.testing.assert_array_equal(valid_sums, PHI.sums_of_blocks(valid))


def test_offsets_are_taken_off_valid_sums() -> None:
    offsets = np.arange(16, dtype="<i4") * 100 - 700
    counts, _, valid_sums, _ = decode_measurement(msgspec.structs.replace(GOOD, offsets=offsets.tobytes()), PHI)
    np.testing.assert_array_equal(counts[valid_sums], (SUMS - offsets)[valid_sums])
    assert not counts[~valid_sums].any()


def test_a_defective_sum_is_left_out_and_its_block_is_not_valid() -> None:
    usable = np.ones(16, np.uint8)
    usable[5] = 0
    counts, valid, valid_sums, _ = decode_measurement(msgspec.structs.replace(GOOD, usable=usable.tobytes()), PHI)
    came = PHI.sums_of_blocks(np.frombuffer(GOOD.valid, np.bool_))
    np.testing.assert_array_equal(valid_sums, came & (usable != 0))
    assert counts[5] == 0
    assert not valid[PHI.block_of_sum[5]]
    assert valid.sum() == 6


def test_doubtful_taxels_are_bits_row_by_row() -> None:
    assert doubtful_taxels(GOOD, 64) is None
    bits = np.arange(11) % 3 == 0
    marked = msgspec.structs.replace(GOOD, doubtful=np.packbits(bits).tobytes())
    found = doubtful_taxels(marked, 11)
    assert found is not None
    assert found.dtype == np.bool_
    np.testing.assert_array_equal(found, bits)
    with pytest.raises(InputError, match="doubtful of 2 bytes, expected 3, or none"):
        doubtful_taxels(marked, 17)
    whole = msgspec.structs.replace(GOOD, doubtful=bytes(8))
    decode_measurement(whole, PHI)
    decode_stepped(msgspec.structs.replace(STEPPED, doubtful=bytes(8)), PHI)


@pytest.mark.parametrize(("changed", "says"), BAD)
def test_what_does_not_fit_is_refused(changed: dict[str, object], says: str) -> None:
    with pytest.raises(InputError, match=says) as caught:
        decode_measurement(msgspec.structs.replace(GOOD, **changed), PHI)
    assert len(str(caught.value)) < 200
    assert str(caught.value).isprintable()


BAD_STEPPED = (
    ({"fingerprint": "0" * 16}, f"measured with Φ '0000000000000000', expected {PHI.fingerprint}"),
    ({"sums": GOOD.sums[:-1]}, "sums of 63 bytes, expected 64"),
    ({"known": b"\1"}, "known of 1 bytes, expected 16"),
    ({"states": b""}, "states of 0 bytes, expected 8"),
    ({"since_ns": b"\0" * 8}, "since_ns of 8 bytes, expected 64"),
    ({"states": bytes([4] * 8)}, "a block's state is 4, expected 0 to 3"),
    ({"states": bytes([3, 1, 2, 1, 2, 2, 2, 2])}, "a block is valid, but neither fresh nor quiet"),
    ({"noise_n": float("nan")}, "noise_n of nan, expected a number of 0 or more"),
    ({"noise_n": -1e-3}, "noise_n of -0.001"),
    ({"valid": bytes([1, 1, *[1] * 6])}, "a block is valid, but not all its sums are known"),
    ({"doubtful": bytes(9)}, "doubtful of 9 bytes, expected 8, or none"),
    ({"offsets": np.full(16, -(2**31), "<i4").tobytes()}, "sums less offsets beyond 2147483647 counts"),
)


def test_stepped_sums_say_what_is_known_of_each() -> None:
    sums = decode_stepped(STEPPED, PHI)
    np.testing.assert_array_equal(sums.counts, np.where(sums.known, SUMS, 0))
    assert np.flatnonzero(~sums.known).tolist() == [2]
    assert np.flatnonzero(~sums.valid).tolist() == [1]
    assert sums.noise_n == 1e-3
    offsets = np.arange(16, dtype="<i4")
    less = decode_stepped(msgspec.structs.replace(STEPPED, offsets=offsets.tobytes()), PHI)
    np.testing.assert_array_equal(less.counts, np.where(sums.known, SUMS - offsets, 0))
    usable = msgspec.structs.replace(STEPPED, usable=bytes([0, *[1] * 15]))
    assert np.flatnonzero(~decode_stepped(usable, PHI).known).tolist() == [0, 2]
    assert np.flatnonzero(~decode_stepped(usable, PHI).valid).tolist() == [0, 1]
    nothing = msgspec.structs.replace(STEPPED, known=bytes(16), valid=bytes(8), states=bytes(8))
    assert not decode_stepped(nothing, PHI).known.any()


@pytest.mark.parametrize(("changed", "says"), BAD_STEPPED)
def test_stepped_sums_that_do_not_fit_are_refused(changed: dict[str, object], says: str) -> None:
    with pytest.raises(InputError, match=says):
        decode_stepped(msgspec.structs.replace(STEPPED, **changed), PHI)


def test_a_measurement_of_the_other_kind_is_refused() -> None:
    with pytest.raises(InputError, match="a measurement of steps sending, expected synchronous: give both ends the"):
        decode_measurement(STEPPED, PHI)
    with pytest.raises(InputError, match="a measurement of synchronous sending, expected steps: give both ends the"):
        decode_stepped(GOOD, PHI)


def test_refusals_are_counted_and_named_once_in_a_while(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    reader = MeasurementReader(PHI, "classifier", decode_measurement)
    for changed, _ in BAD:
        assert reader.read(msgspec.structs.replace(GOOD, **changed)) is None
    assert reader.read(GOOD) is not None
    assert reader.refused == len(BAD)
    assert [record.__dict__["service"] for record in caplog.records] == ["classifier"]
    assert caplog.messages[0].startswith("measurement refused (1 so far): measured with Φ")
    now_s = measured_sums.time.monotonic() + measured_sums.COMPLAINT_PERIOD_S
    monkeypatch.setattr(measured_sums.time, "monotonic", lambda: now_s)
    reader.read(msgspec.structs.replace(GOOD, sums=b""))
    assert f"({len(BAD) + 1} so far)" in caplog.messages[1]
