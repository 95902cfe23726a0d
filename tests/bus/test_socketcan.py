"""The parts of the SocketCAN link that need no CAN in the kernel: the frame layout and the batched system calls."""

import socket
import struct
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bus.datagrams import (
    SO_RXQ_OVFL,
    SO_TIMESTAMPING,
    SO_TIMESTAMPNS,
    decode,
    new_datagrams,
    read_datagrams,
    send_datagrams,
)
from bus.link import open_link
from bus.told import CAME, DESCRIPTOR, DROPPED, HAS_FAILED, NEEDS_LOOK, NO_STAMPS, OFFSET, RETURNED, STAMP_ERROR
from canskin.errors import BusError
from dbc.canopen import SYNC_COB_ID
from dbc.frame import BRS, CAN_ID_AT, ECHO, ERROR, ESI, EXTENDED, FD, FRAME, REMOTE, Frames, frame_bytes
from tests.bus.harness import burst, frame

NOW_NS, OFFSET_NS, MSG_CONFIRM = 77, 500, 0x800


class Room:
    """Room for the datagrams of a socket, with remains of older ones."""

    def __init__(self, descriptor: int = -1) -> None:
        self.rows = np.full((1, 256, FRAME.itemsize), 0xAA, np.uint8)
        (self.messages,), (self.parts,) = new_datagrams(self.rows)
        self.told = np.zeros(RETURNED, np.int64)
        self.told[DESCRIPTOR], self.told[OFFSET] = descriptor, OFFSET_NS

    @property
    def frames(self) -> Frames:
        return np.ndarray(int(self.told[CAME]), FRAME, self.rows).copy()

    def put(self, wire: bytes, control: bytes = b"", flags: int = 0) -> None:
        """Leave a datagram as the kernel does."""
        place = int(self.told[CAME])
        self.rows[0, place, CAN_ID_AT : CAN_ID_AT + len(wire)] = tuple(wire)
        self.messages[place, 5:] = len(control), flags, len(wire)
        self.parts.view(np.uint8)[place, 16 : 16 + len(control)] = tuple(control)
        self.told[CAME] += 1

    def decode(self) -> Frames:
        decode(int(self.told[CAME]), NOW_NS, self.told, self.rows[0].view(np.int64), self.messages, self.parts)
        return self.frames

    def read(self) -> Frames:
        self.told[CAME] = 0
        read_datagrams(self.told, self.rows[0], self.messages, self.parts, np.zeros(2, np.int64))
        return self.frames

    def send(self, sent: Frames) -> int:
        words = self.rows[0].view(np.int64)
        return send_datagrams(self.told[DESCRIPTOR], frame_bytes(sent), words, self.messages, self.parts)


def wire_of(one: Frames) -> bytes:
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    with near, far:
        assert Room(near.fileno()).send(one) == 1
        return far.recv(100)


def told(kind: int, data: bytes) -> bytes:
    """Return control data of one kind."""
    return struct.pack("=Qii", 16 + len(data), socket.SOL_SOCKET, kind) + data.ljust(-(-len(data) // 8) * 8, b"\0")


STAMP = told(SO_TIMESTAMPNS, struct.pack("=qq", 7, 5))
DEVICE = told(SO_TIMESTAMPING, struct.pack("=6q", 0, 0, 0, 0, 3, 9))


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
    assert wire_of(one) == wire


@given(st.integers(0, 0x1FFFFFFF), st.sampled_from([0, FD, FD | BRS, FD | ESI]), st.booleans(), st.binary(max_size=8))
def test_decoding_undoes_encoding(number: int, kind: int, extended: bool, data: bytes) -> None:
    sent, room = frame(number if extended else number & 0x7FF, data, kind | (EXTENDED if extended else 0)), Room()
    room.put(wire_of(sent), STAMP)
    got = room.decode()
    assert got["time_ns"][0] == 7_000_000_005 - OFFSET_NS
    got["time_ns"] = 0
    assert got.tobytes() == sent.tobytes()
    assert not room.told[NEEDS_LOOK]


def test_python_looks_at_errors_at_frames_without_stamps_and_at_what_a_device_has_stamped() -> None:
    error = struct.pack("=IB3x8s", 0x20000204, 8, bytes([0, 0x20, 0, 0, 0, 0, 130, 0]))
    sync, other = wire_of(frame(SYNC_COB_ID)), wire_of(frame(0x181))
    for wire, control, flags, looks, expected in (
        (sync, STAMP, MSG_CONFIRM, False, (SYNC_COB_ID, ECHO, 0)),
        (sync, STAMP + DEVICE, MSG_CONFIRM, True, (SYNC_COB_ID, ECHO, 3_000_000_009)),
        (sync, STAMP + DEVICE, 0, False, (SYNC_COB_ID, 0, 0)),
        (other, STAMP + DEVICE, MSG_CONFIRM, False, (0x181, ECHO, 0)),
        (other, b"", 0, True, (0x181, 0, 0)),
        (error, STAMP, 0, True, (0x204, ERROR, 0)),
    ):
        room = Room()
        room.put(wire, control, flags)
        (got,) = room.decode()
        assert (got["can_id"], got["flags"], got["expires_ns"]) == expected
        assert room.told[NEEDS_LOOK] == looks
        assert got["time_ns"] == (7_000_000_005 - OFFSET_NS if control else NOW_NS)
        assert (room.told[STAMP_ERROR] == NO_STAMPS) == (not control)


def test_what_an_older_frame_left_in_the_buffer_is_not_seen() -> None:
    room = Room()
    for wire in (
        struct.pack("=IB3x8s", 0x181, 3, b"\x01\x02\x03\xee\xee\xee\xee\xee"),
        bytes(5),  # no CAN frame
        struct.pack("=IB3x8s", 0x182, 9, bytes(range(8))),
    ):
        room.put(wire)
    got = room.decode()
    assert (got["can_id"].tolist(), got["length"].tolist(), got["port"].tolist()) == ([0x181, 0x182], [3, 8], [0, 0])
    assert [bytes(one) for one in got["data"]] == [bytes((1, 2, 3)) + bytes(61), bytes(range(8)) + bytes(56)]


def test_hundreds_of_datagrams_in_a_few_system_calls() -> None:
    left, right = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
    with left, right:
        right.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        sender, receiver = Room(left.fileno()), Room(right.fileno())
        assert len(receiver.read()) == 0
        sent = np.concatenate([burst(range(30)), frame(0x7FF, bytes(64), FD)])
        done, got = 0, []
        while done < len(sent):  # such a socket holds few datagrams
            done += sender.send(sent[done:])
            got.append(receiver.read())
            assert len(got[-1]) > 1
        arrived = np.concatenate(got)
        assert abs(arrived["time_ns"] - time.monotonic_ns()).max() < 60e9
        arrived["time_ns"] = 0
        assert arrived.tobytes() == sent.tobytes()
        assert not receiver.told[HAS_FAILED]
        right.close()
        assert sender.send(sent) == -1


@pytest.mark.parametrize(
    ("control", "dropped"),
    [
        ((STAMP, DEVICE, told(SO_RXQ_OVFL, struct.pack("=I", 41))), 41),
        ((STAMP, told(SO_RXQ_OVFL, struct.pack("=I", 42))), 42),
        ((told(SO_RXQ_OVFL, b"\x2a\0\0\0"), STAMP), 42),
        ((STAMP,), 3),
    ],
)
def test_stamps_and_drop_counts_are_read_where_they_are(control: tuple[bytes, ...], dropped: int) -> None:
    room = Room()
    room.told[DROPPED] = 3
    room.put(wire_of(frame(SYNC_COB_ID)), b"".join(control), MSG_CONFIRM)
    (got,) = room.decode()
    assert got["time_ns"] == 7_000_000_005 - OFFSET_NS
    assert got["expires_ns"] == 3_000_000_009 * (DEVICE in control)
    assert room.told[DROPPED] == dropped


def test_a_missing_interface_is_one_line() -> None:
    with pytest.raises(BusError, match="cannot open nocan9") as caught:
        open_link("socketcan", "nocan9", 1_000_000)
    assert "\n" not in str(caught.value)
