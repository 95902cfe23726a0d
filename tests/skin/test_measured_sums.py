"""A measurement is decoded when it fits Φ; what does not fit is refused with a reason, and named once in a while."""

import msgspec
import numpy as np
import pytest

from skin import measured_sums
from skin.errors import InputError
from skin.measured_sums import MeasurementReader, decode_measurement
from skin.measurement import sbhe
from skin.messages import Measurement

PHI = sbhe(64, 16, block_size=8)
SUMS = np.arange(-8, 8, dtype="<i4")
GOOD = Measurement(
    cycle=1,
    sync_counter=1,
    sync_mono_ns=1,
    time_ns=1,
    sums=SUMS.tobytes(),
    valid=bytes([1, 0, 1, 1, 1, 1, 1, 1]),
    fingerprint=PHI.fingerprint,
)
BAD = (
    ({"fingerprint": "0" * 16}, f"measured with Φ '0000000000000000', expected {PHI.fingerprint}"),
    ({"fingerprint": "\x1b[2J" * 1000}, "measured with Φ '.x1b"),
    ({"sums": GOOD.sums[:-1]}, "sums and validity of 63 and 8 bytes, expected 64 and 8"),
    ({"valid": GOOD.valid + b"\1"}, "sums and validity of 64 and 9 bytes, expected 64 and 8"),
    ({"sums": b"", "valid": b""}, "sums and validity of 0 and 0 bytes"),
)


def test_sums_and_validity() -> None:
    counts, valid = decode_measurement(GOOD, PHI)
    assert counts.dtype == np.int32
    np.testing.assert_array_equal(counts, SUMS)
    assert valid.tolist() == [True, False, True, True, True, True, True, True]


@pytest.mark.parametrize(("changed", "says"), BAD)
def test_what_does_not_fit_is_refused(changed: dict[str, object], says: str) -> None:
    with pytest.raises(InputError, match=says) as caught:
        decode_measurement(msgspec.structs.replace(GOOD, **changed), PHI)
    assert len(str(caught.value)) < 200
    assert str(caught.value).isprintable()


def test_refusals_are_counted_and_named_once_in_a_while(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    reader = MeasurementReader(PHI, "classifier")
    for changed, _ in BAD:
        assert reader.read(msgspec.structs.replace(GOOD, **changed)) is None
    assert reader.read(GOOD) is not None
    assert reader.refused == len(BAD)
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 1
    assert said[0].startswith("classifier: measurement refused (1 so far): measured with Φ")
    now_s = measured_sums.time.monotonic() + measured_sums.COMPLAINT_PERIOD_S
    monkeypatch.setattr(measured_sums.time, "monotonic", lambda: now_s)
    reader.read(msgspec.structs.replace(GOOD, sums=b""))
    assert f"({len(BAD) + 1} so far)" in capsys.readouterr().err
