"""How full a bus was, since the last look and since SYNC started."""

import numpy as np
import pytest

from dbc.frame import ECHO, ERROR, frame_bytes
from gateway.load import LoadMeter
from skin.layout import Bus
from tests.bus.harness import frame

#: 500 kbit/s; a frame of 8 bytes has 111 bits, and this one no stuff bits but for some in its CRC.
WIRES = Bus(name="bus0", nodes=1, bitrate=500_000)
PLAIN = frame(0x555, b"\x55" * 8)
FRAME_S = 111 / 500_000


def meter(now_s: float) -> LoadMeter:
    return LoadMeter(WIRES, now_s, np.zeros(1, np.int64))


def test_load_is_the_time_of_the_frames_over_the_time_since_the_last_look() -> None:
    load = meter(10.0)
    load.take(frame_bytes(np.repeat(PLAIN, 100)))
    assert load.take_ratio(11.0) == pytest.approx(100 * FRAME_S, rel=0.05)
    assert load.take_ratio(12.0) == 0.0
    load.take(frame_bytes(np.repeat(PLAIN, 100)))
    assert load.take_ratio(14.0) == pytest.approx(50 * FRAME_S, rel=0.05)


def test_mean_load_counts_from_the_restart() -> None:
    load = meter(10.0)
    load.take(frame_bytes(np.repeat(PLAIN, 100)))
    load.take(frame_bytes(PLAIN))
    load.restart(20.0)
    assert load.mean_ratio(21.0) == load.take_ratio(21.0) == 0.0
    load.take(frame_bytes(np.repeat(PLAIN, 100)))
    assert load.take_ratio(22.0) == pytest.approx(100 * FRAME_S, rel=0.05)
    assert load.mean_ratio(24.0) == pytest.approx(25 * FRAME_S, rel=0.05)


def test_own_frames_take_time_and_frames_given_back_take_none() -> None:
    load = meter(0.0)
    own, unsent = PLAIN.copy(), PLAIN.copy()
    own["flags"], unsent["flags"] = ECHO, ECHO | ERROR
    load.take(frame_bytes(np.concatenate((own, unsent))))
    assert load.take_ratio(1.0) == pytest.approx(FRAME_S, rel=0.05)


def test_no_time_is_no_load() -> None:
    load = meter(1.0)
    load.take(frame_bytes(PLAIN))
    assert load.take_ratio(1.0) == load.mean_ratio(1.0) == 0.0
