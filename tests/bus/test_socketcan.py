"""The parts of the SocketCAN link that need no CAN in the kernel: the frame layout and the batched system calls."""

import socket
import struct
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bus.interface import FD_BYTES
from bus.link import open_link
from bus.recvmmsg import SO_RXQ_OVFL, SO_TIMESTAMPING, SO_TIMESTAMPNS, BatchSocket, Received, _read_control
from bus.socketcan import decode, encode
from canskin.errors import BusError
from dbc.frame import BRS, ECHO, ERROR, ESI, EXTENDED, FD, REMOTE, Frames
from tests.bus.harness import burst, frame


def through(sent: Frames, msg_flags: int = 0, stamp_ns: int = 0) -> Frames:
    rows, lengths = encode(sent)
    count = len(rows)
    stamps = np.full(count, stamp_ns, np.int64)
    received = Received(
        rows, lengths.astype(np.uint32), np.full(count, msg_flags, np.int32), stamps, np.zeros_like(stamps), None
    )
    return decode(received, 500)


def unstamped(rows: np.ndarray, lengths: list[int]) -> Received:
    none = np.zeros(len(rows), np.int64)
    return Received(rows, np.array(lengths, np.uint32), none.astype(np.int32), none, none, None)


@pytest.mark.parametrize(
    ("one", "wire"),
    [
        (frame(0x123, b"\x01\x02"), struct.pack("=IB3x8s", 0x123, 2, b"\x01\x02")),
        (frame(0x1ABCDEF0, flags=EXTENDED), struct.pack("=IB3x8s", 0x9ABCDEF0, 0, b"")),
        (frame(0x701, flags=REMOTE), struct.pack("=IB3x8s", 0x40000701, 0, b"")),
        (frame(0x181, bytes(12), FD | BRS | ESI), struct.pack("=IBB2x64s", 0x181, 12, 3, b"")),
    ],
)
def test_frames_are_laid_out_as_the_kernel_wants_them(one: Frames, wire: bytes) -> None:
    rows, lengths = encode(one)
    assert bytes(rows[0, : lengths[0]]) == wire


@given(st.integers(0, 0x1FFFFFFF), st.sampled_from([0, FD, FD | BRS, FD | ESI]), st.booleans(), st.binary(max_size=8))
def test_decoding_undoes_encoding(number: int, kind: int, extended: bool, data: bytes) -> None:
    sent = frame(number if extended else number & 0x7FF, data, kind | (EXTENDED if extended else 0))
    got = through(sent, stamp_ns=1_000_500)
    assert got["time_ns"][0] == 1_000_000
    got["time_ns"] = 0
    assert got.tobytes() == sent.tobytes()


def test_own_frames_errors_and_missing_stamps() -> None:
    assert through(frame(0x80), msg_flags=0x800)["flags"][0] == ECHO
    error = np.zeros((1, FD_BYTES), np.uint8)
    error[0, :16] = np.frombuffer(struct.pack("=IB3x8s", 0x20000204, 8, bytes([0, 0x20, 0, 0, 0, 0, 130, 0])), np.uint8)
    before_ns = time.monotonic_ns()
    got = decode(unstamped(error, [16]), 0)[0]
    assert (got["can_id"], got["flags"], got["data"][6]) == (0x204, ERROR, 130)
    assert got["time_ns"] >= before_ns


def test_what_an_older_frame_left_in_the_buffer_is_not_seen() -> None:
    rows = np.full((2, FD_BYTES), 0xAA, np.uint8)
    rows[0, :16] = np.frombuffer(struct.pack("=IB3x8s", 0x181, 3, b"\x01\x02\x03\xee\xee\xee\xee\xee"), np.uint8)
    got = decode(unstamped(rows, [16, 5]), 0)  # the second is no CAN frame
    assert len(got) == 1
    assert bytes(got["data"][0]) == b"\x01\x02\x03" + bytes(61)


def test_hundreds_of_datagrams_in_a_few_system_calls() -> None:
    left, right = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    with left, right:
        left.setblocking(False)
        right.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        sender, receiver = BatchSocket(left, 64, FD_BYTES), BatchSocket(right, 64, FD_BYTES)
        assert len(receiver.receive().rows) == 0
        sent = np.concatenate([burst(range(30)), frame(0x7FF, bytes(64), FD)])
        rows, lengths = encode(sent)
        done, got = 0, []
        while done < len(sent):  # such a socket holds few datagrams
            done += sender.send(rows[done:], lengths[done:])
            got.append(decode(receiver.receive(), time.time_ns() - time.monotonic_ns()))
        arrived = np.concatenate(got)
        assert abs(arrived["time_ns"] - time.monotonic_ns()).max() < 60e9
        arrived["time_ns"] = 0
        assert arrived.tobytes() == sent.tobytes()
        right.close()
        with pytest.raises(ConnectionRefusedError):
            sender.send(rows, lengths)


def control(*messages: tuple[int, bytes]) -> tuple[bytes, int]:
    packed = b""
    for kind, data in messages:
        packed += struct.pack("=Qii", 16 + len(data), socket.SOL_SOCKET, kind) + data.ljust(
            -(-len(data) // 8) * 8, b"\0"
        )
    return packed.ljust(128, b"\xff"), len(packed)


def test_stamps_and_drop_counts_are_read_where_they_are() -> None:
    stamp, drops = struct.pack("=qq", 7, 5), struct.pack("=I", 42)
    device = struct.pack("=6q", 0, 0, 0, 0, 3, 9)
    made = [
        control((SO_TIMESTAMPNS, stamp), (SO_TIMESTAMPING, device)),
        control((SO_TIMESTAMPNS, stamp), (SO_TIMESTAMPING, device), (SO_RXQ_OVFL, struct.pack("=I", 41))),
        control((SO_TIMESTAMPNS, stamp)),
        control((SO_TIMESTAMPNS, stamp), (SO_RXQ_OVFL, drops)),
        control((SO_RXQ_OVFL, drops[:1] + b"\0\0\0")),
        control(),
    ]
    rows = np.frombuffer(b"".join(one for one, _ in made), np.uint8).reshape(-1, 128)
    times, devices, dropped = _read_control(rows, np.array([size for _, size in made], np.uintp))
    assert times.tolist() == 4 * [7_000_000_005] + [0, 0]
    assert devices.tolist() == 2 * [3_000_000_009] + 4 * [0]
    assert dropped == 42
    for count, dropped in ((2, 41), (1, None)):
        assert _read_control(rows[:count], np.array([size for _, size in made[:count]], np.uintp))[2] == dropped


def test_a_missing_interface_is_one_line() -> None:
    with pytest.raises(BusError, match="cannot open nocan9") as caught:
        open_link("socketcan", "nocan9", 1_000_000)
    assert "\n" not in str(caught.value)
