"""Logs of every format that needs no further package, written by python-can and read back."""

import gzip
from pathlib import Path
from types import SimpleNamespace

import can
import numpy as np
import pytest

from bandwidth.logs import listen, of_buses, read_log
from canskin.errors import InputError
from dbc.frame import BRS, EXTENDED, FD, Frames, frames
from skin.layout import load_layout
from tests.bus.harness import burst, frame, linked, serving


def refuse_warning(line: str) -> None:
    raise AssertionError(line)


def messages() -> list[can.Message]:
    kinds = (
        {"arbitration_id": 0x181, "data": bytes(range(8)), "is_extended_id": False},
        {"arbitration_id": 0x1ABCDEF, "data": b"\x01", "is_extended_id": True},
        {"arbitration_id": 0x182, "data": bytes(12), "is_extended_id": False, "is_fd": True, "bitrate_switch": True},
        {"arbitration_id": 0x80, "data": b"", "is_extended_id": False},
    )
    return [can.Message(timestamp=1000.0 + 0.01 * place, channel=0, **kind) for place, kind in enumerate(kinds)]


def test_identifiers_are_from_0_on(tmp_path: Path) -> None:
    """0 is that of NMT (CiA 301)."""
    path = tmp_path / "nmt.log"
    path.write_bytes(b"(0.0) can0 000#0100\n(0.1) can0 1FFFFFFF#01\n")
    assert list(seen(read_log(path, refuse_warning))["can_id"]) == [0, 0x1FFFFFFF]


def seen(logged: dict[str, Frames]) -> Frames:
    (only,) = logged.values()
    return only


@pytest.mark.parametrize("suffix", [".log", ".asc", ".blf", ".log.gz"])
def test_formats(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"log{suffix}"
    with can.Logger(path) as logger:
        for message in messages():
            logger(message)
    found = seen(read_log(path, refuse_warning))
    assert list(found["can_id"]) == [0x181, 0x1ABCDEF, 0x182, 0x80]
    assert list(found["length"]) == [8, 1, 12, 0]
    assert list(found["flags"]) == [0, EXTENDED, FD | BRS, 0]
    assert bytes(found["data"][0, :8]) == bytes(range(8))
    assert np.diff(found["time_ns"]) == pytest.approx(10_000_000, abs=1_000_000)


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("none.log", None, "no such log"),
        ("empty.log", b"", "holds no CAN frame"),
        ("words.log", b"these are words\n", "cannot be read"),
        ("bytes.blf", bytes(200), "cannot be read"),
        ("what.pdf", b"%PDF-1.7\n", "line 1: cannot be read as a log of CAN frames: expected a frame"),
        ("never.log", b"(1e400) can0 181#01\n", "line 1: cannot be read"),
        ("before.log", b"(-0.5) can0 181#01\n", "line 1: .* a time of -0.5 s"),
        ("half.log", b"(1.0) can0 181#0100\n(1.1) can0 181#01G0\n(1.2) can0 181#01\n", "line 2: cannot be read"),
        ("long.log", b"(1.0) can0 181#112233445566778899\n", "line 1: .* a frame of 9 bytes"),
        ("latin.log", b"(1.0) can0 181#01\n(1.1) \xe4 181\n", "line 2: cannot be read"),
        ("id.asc", b"0.0 1 1FFFFFFFFFx Rx d 8\n", "line 1: .* an identifier of 1FFFFFFFFFh"),
        ("long.trc", b";$FILEVERSION=1.1\n1) 1.0 Rx 0181 300 01\n", "holds no CAN frame"),
        ("packed.blf.gz", gzip.compress(bytes(200), mtime=0), "expected lines in a .gz"),
        ("id.csv", b"head\n1.0,FFFFFFFFFF,1,0,0,0,\n", "line 2: .* an identifier of FFFFFFFFFFh"),
        ("damaged.db", b"no database", "cannot be read"),
        ("damaged.log.gz", b"\x1f\x8b\x08" + bytes(7) + b"\xff" * 40, "cannot be read"),
        ("printed.log", b"  can0  181   [3]  01 02 03\n", "line 1: .*'candump -l'"),
        ("timed.log", b" (1.000000)  can0  1ABCDEF0   [0] \n", "line 1: .*'candump -l'"),
        ("extra.log", b" (1.000000)  can0  RX - -  181   [1]  01\n", "line 1: .*'candump -l'"),
    ],
)
def test_bad_logs_are_one_clear_error(tmp_path: Path, name: str, content: bytes | None, said: str) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=said):
        read_log(path, lambda _: None)
    assert str(path) not in [str(each.readlink()) for each in Path("/proc/self/fd").iterdir() if each.exists()]


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
def test_a_live_bus_is_listened_to(monkeypatch: pytest.MonkeyPatch) -> None:
    with serving("bus0"), linked("talker", "listener") as (talker, listener):
        sent, arrived = burst(range(20)), 0
        receive = listener.receive

        def counted() -> Frames:
            nonlocal arrived
            seen = receive()
            arrived += len(seen)
            return seen

        monkeypatch.setattr(listener, "receive", counted)
        talker.send(sent)
        heard = listen({7: listener}, 60.0, lambda: arrived >= len(sent))
        assert list(heard[7]["can_id"]) == list(range(20))


def test_listening_looks_five_times_a_second_whether_to_end(monkeypatch: pytest.MonkeyPatch) -> None:
    waits: list[float] = []

    def select(_read: list[object], _write: list[object], _error: list[object], timeout_s: float) -> None:
        waits.append(timeout_s)

    monkeypatch.setattr("bandwidth.logs.select", SimpleNamespace(select=select))
    monkeypatch.setattr("bandwidth.logs.time", SimpleNamespace(monotonic=lambda: 100.0 + sum(waits)))
    assert listen({}, 0.5, lambda: False) == {}
    assert waits == pytest.approx([0.2, 0.2, 0.1])
    assert listen({}, 0.5, lambda: True) == {}
    assert len(waits) == 3


@pytest.mark.parametrize("name", ["can.txt", "can.candump", "can"])
def test_a_log_of_candump_may_have_any_name(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_bytes(b"\n" + LINES)
    assert list(seen(read_log(path, refuse_warning))["can_id"]) == [0x181, 0x182]
    path.write_bytes(b"  can0  181   [3]  01 02 03\n")
    with pytest.raises(InputError, match="'candump -l'"):
        read_log(path, refuse_warning)


LINES = b"(1.0) can0 181#0102030405060708\n(1.1) can0 182#0102030405060708\n"


@pytest.mark.parametrize("rest", [b"(1.2) can0 183#0102", b"(1.", b"(1.2) can0 183#01020304050607G", bytes(100)])
def test_a_log_that_was_cut_is_read_up_to_there(tmp_path: Path, rest: bytes) -> None:
    path = tmp_path / "cut.log"
    path.write_bytes(LINES + rest)
    said: list[str] = []
    assert list(seen(read_log(path, said.append))["can_id"]) == [0x181, 0x182]
    assert said == [f"{path}: line 3 is cut off: read up to line 2"]


def test_a_compressed_log_that_was_cut_is_read_up_to_there(tmp_path: Path) -> None:
    path = tmp_path / "cut.log.gz"
    whole = gzip.compress(b"".join(b"(%d.0) can0 181#0102030405060708\n" % each for each in range(20_000)))
    path.write_bytes(whole[: len(whole) // 2])
    said: list[str] = []
    assert 0 < len(seen(read_log(path, said.append))) < 20_000
    assert len(said) == 1
