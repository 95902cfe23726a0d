"""Requests for a new zero are checked in one place; the state of the zero in words."""

from typing import Any

import msgspec
import numpy as np
import pytest

from canskin.calibration_messages import (
    CalibrationRequest,
    CalibrationState,
    CalibrationStatus,
    ZeroSupport,
    tare_request,
)
from canskin.errors import InputError

STATUS = CalibrationStatus(state=CalibrationState.FOLLOWING)


@pytest.mark.parametrize("region", [(0, 1, 3, 7), ["0", "1", " 3", "7"], np.array((0, 1, 3, 7))])
def test_a_region_is_four_whole_numbers_or_their_texts(region: Any) -> None:
    assert tare_request(4, 8, region=region) == CalibrationRequest(action="tare", region=(0, 1, 3, 7))


@pytest.mark.parametrize(
    "region",
    [
        *[(), (0, 1, 2), (0, 1, 2, 3, 4), (0, 1, 2, 8), (0, 1, 4, 7), (-1, 0, 1, 1), (2, 0, 1, 1), (0, 2, 1, 1)],
        *[(0, 0, 1, 1.5), ("0", "0", "x", "1"), ("",), (0, 0, 1, None), ("9" * 9999,)],
    ],
)
def test_a_region_that_is_none_is_named(region: Any) -> None:
    with pytest.raises(InputError, match=r"region .*: expected .* rows of 0 to 3 and columns of 0 to 7") as caught:
        tare_request(4, 8, region=region)
    assert len(str(caught.value)) < 250


def test_a_region_by_force_is_refused() -> None:
    assert tare_request(4, 8, force=True) == CalibrationRequest(action="tare", force=True)
    with pytest.raises(InputError, match="expected one of both"):
        tare_request(4, 8, force=True, region=(0, 0, 1, 1))


def test_a_request_keeps_its_region_on_the_wire() -> None:
    for region in ((0, 1, 2, 3), "thumb"):
        request = tare_request(4, 8, region=region)
        assert request.region == region
        assert msgspec.msgpack.decode(msgspec.msgpack.encode(request), type=CalibrationRequest) == request


def test_the_zero_in_words() -> None:
    off = CalibrationStatus(state=CalibrationState.OFF, zero_support=bytes(3))
    for each in (STATUS, off):
        assert (each.zero_words, each.doubtful_words, each.oldest_zero_s) == ("", "", None)
    some = [ZeroSupport.MEASURED] * 3 + [ZeroSupport.STORED, ZeroSupport.NONE, ZeroSupport.STORED]
    told = msgspec.structs.replace(STATUS, zero_support=bytes(some), told_mono_ns=60_000_000_000)
    assert told.zero_words == "3 measured, 2 stored, 1 none"
    times = np.array([0, 25_000_000_000, 30_000_000_000], "<i8").tobytes()
    known = msgspec.structs.replace(told, zero_mono_ns=times)
    assert known.oldest_zero_s == pytest.approx(35.0)
    assert known.zero_words == "3 measured, 2 stored, 1 none; oldest 35 s"
    assert msgspec.structs.replace(known, zero_mono_ns=times + b"cut", zero_support=b"\xff").zero_words == ""


def test_doubtful_taxels_in_words() -> None:
    doubtful = msgspec.structs.replace(STATUS, doubtful_taxels=12, doubtful_force_n=0.4321)
    assert doubtful.doubtful_words == "12, with 0.432 N"
    timed = msgspec.structs.replace(doubtful, doubtful_since_mono_ns=15_000_000_000, told_mono_ns=60_000_000_000)
    assert timed.doubtful_words == "12, with 0.432 N for 45 s"
