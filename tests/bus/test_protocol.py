"""Packets between a bus and its clients, and which frames a controller could send."""

import time
from pathlib import Path

import numpy as np
import pytest

from bus.protocol import (
    MAX_PACKET,
    Header,
    Hello,
    Kind,
    ProtocolError,
    check_frames,
    in_time,
    pack,
    padded,
    socket_path,
    unpack,
    unpack_frames,
    unpack_json,
)
from canskin.errors import InputError
from dbc.frame import BRS, ECHO, ERROR, ESI, EXTENDED, FD, REMOTE, Frames
from tests.bus.harness import burst, frame

#: A frame that needs the long check, and nothing wrong with it.
OTHER = frame(0x1FFFFFFF, flags=EXTENDED)


def test_a_packet_begins_with_24_bytes() -> None:
    """magic, kind, state, frames (16 bits), dropped and bus time (64 bits each), little-endian."""
    kinds = (Kind.HELLO, Kind.WELCOME, Kind.REFUSED, Kind.FRAMES)
    assert [pack(kind)[4] for kind in kinds] == [1, 2, 3, 4]
    assert pack(Kind.FRAMES, b"xy", count=258) == b"CSK1\x04\x00\x02\x01" + bytes(16) + b"xy"
    header, payload = unpack(b"CSK1\x04\x02\x02\x01" + b"\7" + bytes(7) + b"\xff" * 8 + b"xy")
    assert header == Header(kind=4, state=2, frames=258, dropped=7, time_ns=-1)
    assert bytes(payload) == b"xy"
    assert bytes(unpack(pack(Kind.HELLO))[1]) == b""
    assert 24 + 512 * burst([1]).itemsize == MAX_PACKET


@pytest.mark.parametrize("packet", [b"", pack(Kind.FRAMES)[:23], b"CSK2" + pack(Kind.FRAMES)[4:]])
def test_what_does_not_begin_so_is_no_packet(packet: bytes) -> None:
    with pytest.raises(ProtocolError):
        unpack(packet)


def test_records_are_as_many_as_the_header_says() -> None:
    sent = burst([1, 2])
    for count in (1, 3):
        header, payload = unpack(pack(Kind.FRAMES, sent.tobytes(), count=count))
        with pytest.raises(ProtocolError, match="bytes for"):
            unpack_frames(header, payload)
    assert unpack_frames(*unpack(pack(Kind.FRAMES, sent.tobytes(), count=2))).tobytes() == sent.tobytes()


def test_a_greeting_needs_a_name_alone() -> None:
    hello = unpack_json(memoryview(b'{"name":"a"}'), Hello)
    assert (hello.bitrate, hello.data_bitrate, hello.fd) == (None, None, False)
    for text in (b"{}", b'{"name":"a","more":1}', b'{"name":"a","bitrate":"fast"}'):
        with pytest.raises(ProtocolError):
            unpack_json(memoryview(text), Hello)


GOOD = [
    frame(0),
    frame(0x7FF, bytes(8), port=255, time_ns=1 << 62),
    frame(0x7FF, flags=REMOTE),
    frame(0x1FFFFFFF, bytes(8), EXTENDED | REMOTE, port=255, time_ns=1 << 62),
]
GOOD_FD = [
    frame(0x7FF, bytes(64), FD | BRS | ESI),
    frame(0x1FFFFFFF, bytes(64), FD | EXTENDED),
    frame(1, b"", FD | ESI),
]
BAD = [
    (frame(0x800), "identifier"),
    (frame(0x20000000, flags=EXTENDED), "identifier"),
    (frame(1, bytes(9)), "more than 8 bytes"),
    (frame(1, bytes(9), EXTENDED), "more than 8 bytes"),
    (frame(1, flags=FD | REMOTE), "remote frame of CAN FD"),
    (frame(1, flags=BRS), "without FD"),
    (frame(1, flags=ESI | EXTENDED), "without FD"),
    (frame(1, flags=ECHO), "receiver"),
    (frame(1, flags=ERROR), "receiver"),
    (frame(1, flags=0x80), "receiver"),
    (frame(1, port=256), "a port above 255"),
    (frame(1, time_ns=(1 << 62) + 1), "a start time above 4611686018427387904 ns"),
]


def test_what_a_controller_can_send_passes() -> None:
    check_frames(burst([])[:0], fd=False)
    for each in GOOD:
        check_frames(each, fd=False)
        check_frames(np.concatenate([OTHER, each]), fd=True)
    for each in GOOD_FD:
        check_frames(each, fd=True)
        with pytest.raises(InputError, match=r"frame 1 .*CAN FD on a classical link"):
            check_frames(np.concatenate([OTHER, each]), fd=False)


@pytest.mark.parametrize(("bad", "what"), BAD)
def test_what_a_controller_cannot_send_is_named(bad: Frames, what: str) -> None:
    with pytest.raises(InputError, match=rf"frame 0 \(identifier 0x{int(bad['can_id'][0]):X}\) has .*{what}"):
        check_frames(bad, fd=True)
    for before in (frame(5), OTHER):
        with pytest.raises(InputError, match=rf"frame 1 .*{what}"):
            check_frames(np.concatenate([before, bad, bad]), fd=True)


def test_lengths_of_can_fd_alone_are_rounded_up() -> None:
    sent = np.concatenate(
        [frame(1, bytes(n), FD) for n in (7, 8, 9, 13, 17, 21, 25, 33, 49, 64)] + [frame(1, bytes(5))]
    )
    before = sent.tobytes()
    assert padded(sent)["length"].tolist() == [7, 8, 12, 16, 20, 24, 32, 48, 64, 64, 5]
    assert sent.tobytes() == before


def test_frames_before_the_first_that_is_late_are_in_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time, "monotonic_ns", lambda: 1000)
    sent = burst([1, 2, 3, 4])
    assert len(in_time(sent)) == 4
    sent["expires_ns"] = [0, 1000, 999, 0]
    assert in_time(sent)["can_id"].tolist() == [1, 2]
    sent["expires_ns"] = [1, 2000, 2000, 0]
    assert len(in_time(sent)) == 0


def test_the_path_of_a_socket_has_107_bytes_at_most() -> None:
    folder = Path("/" + 96 * "a")
    assert socket_path("bus01", folder) == folder / "bus01.can"
    assert len(str(socket_path("bus01", folder))) == 107
    with pytest.raises(InputError, match="too long for a socket"):
        socket_path("bus012", folder)
    for name in ("", "a/b", ".hidden", ".."):
        with pytest.raises(InputError, match="cannot name a bus"):
            socket_path(name, folder)
