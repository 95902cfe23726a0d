"""Logs of every format that needs no further package, written by python-can and read back."""

from pathlib import Path

import can
import numpy as np
import pytest

from bandwidth.logs import listen, of_buses, read_log
from dbc.frame import BRS, EXTENDED, FD, Frames, frames
from skin.errors import InputError
from skin.layout import load_layout
from tests.bus.harness import burst, frame, linked, serving


def messages() -> list[can.Message]:
    kinds = (
        {"arbitration_id": 0x181, "data": bytes(range(8)), "is_extended_id": False},
        {"arbitration_id": 0x1ABCDEF, "data": b"\x01", "is_extended_id": True},
        {"arbitration_id": 0x182, "data": bytes(12), "is_extended_id": False, "is_fd": True, "bitrate_switch": True},
        {"arbitration_id": 0x80, "data": b"", "is_extended_id": False},
    )
    return [can.Message(timestamp=1000.0 + 0.01 * place, channel=0, **kind) for place, kind in enumerate(kinds)]


def seen(logged: dict[str, Frames]) -> Frames:
    (only,) = logged.values()
    return only


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf", ".log.gz"])
def test_formats(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"log{suffix}"
    with can.Logger(path) as logger:
        for message in messages():
            logger(message)
    found = seen(read_log(path))
    assert list(found["can_id"]) == [0x181, 0x1ABCDEF, 0x182, 0x80]
    assert list(found["length"]) == [8, 1, 12, 0]
    assert list(found["flags"]) == [0, EXTENDED, FD | BRS, 0]
    assert bytes(found["data"][0, :8]) == bytes(range(8))
    assert np.diff(found["time_ns"]) == pytest.approx(10_000_000, abs=1_000_000)


# python-can leaves a file open whose header it refuses.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("none.log", None, "no such log"),
        ("empty.log", b"", "holds no CAN frame"),
        ("words.log", b"these are words\n", "cannot be read"),
        ("bytes.blf", bytes(200), "cannot be read"),
        ("what.pdf", b"%PDF", "cannot be read"),
        ("never.log", b"(1e400) can0 181#01\n", "cannot be read"),
        ("half.log", b"(1.0) can0 181#01G0\n", "cannot be read"),
    ],
)
def test_bad_logs_are_one_clear_error(tmp_path: Path, name: str, content: bytes | None, said: str) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=said):
        read_log(path)


def test_channels_are_assigned_by_name_or_in_their_natural_order() -> None:
    layout = load_layout()
    names = [bus.name for bus in layout.bus]
    some = {name: frame(place) for place, name in enumerate(("can10", "can9", "can1"))}
    assigned = of_buses(layout, names, some, Path("x.log"))
    assert [int(each["can_id"][0]) for each in assigned.values()] == [2, 1, 0]
    assert list(of_buses(layout, names, {"bus2": frames(0), "other": frames(0)}, Path("x.log"))) == [2]
    with pytest.raises(InputError, match=r"expected up to 4 channels.*can0, can1, can2, can3, can4"):
        of_buses(layout, names, {f"can{each}": frames(0) for each in range(5)}, Path("x.log"))
    with pytest.raises(InputError, match=r"expected a channel of .*, the log holds can7"):
        of_buses(layout, names, {"can7": frames(0)}, Path("x.log"), named_by_user=True)


@pytest.mark.usefixtures("own_sockets")
def test_a_live_bus_is_listened_to() -> None:
    with serving("bus0"), linked("talker", "listener") as (talker, listener):
        talker.send(burst(range(20)))
        turns = iter([False] * 3)
        heard = listen({7: listener}, 5.0, lambda: next(turns, True))
        assert list(heard[7]["can_id"]) == list(range(20))
