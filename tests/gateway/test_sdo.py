"""SDO transfers as a client: what goes out, what comes back, and what ends a transfer."""

from collections.abc import Generator

import pytest

from dbc.canopen import Abort
from gateway.sdo import (
    ATTEMPTS,
    MOST_LOST,
    Download,
    Read,
    SdoAbortedError,
    SdoDialogue,
    SdoTimeoutError,
    Transfer,
    Write,
    one,
)


class Far:
    """What a dialogue sends, as hexadecimal."""

    def __init__(self) -> None:
        self.sent: list[str] = []

    def __call__(self, cob_id: int, data: bytes) -> None:
        assert cob_id == 0x605
        self.sent.append(data.hex())

    def take(self) -> list[str]:
        sent, self.sent = self.sent, []
        return sent


def begin(transfer: Transfer) -> tuple[SdoDialogue, Far]:
    far = Far()
    return SdoDialogue(5, one(transfer), far, 0.0), far


def answer(dialogue: SdoDialogue, text: str, now_s: float = 0.0) -> None:
    dialogue.take(bytes.fromhex(text), now_s)


@pytest.mark.parametrize(
    ("came", "value"),
    [
        ("4f17100005000000", b"\5"),
        ("4b171000e8030000", b"\xe8\3"),
        ("4317100001020304", b"\1\2\3\4"),
        ("4217100001020304", b"\1\2\3\4"),
        ("4e17100001020304", b"\1\2\3\4"),  # without a size, its number of unused bytes means nothing
    ],
)
def test_expedited_upload(came: str, value: bytes) -> None:
    dialogue, far = begin(Read(0x1017))
    assert far.take() == ["4017100000000000"]
    answer(dialogue, came)
    assert dialogue.done
    assert dialogue.result == value


def test_a_read_whose_answer_must_not_be_used_is_asked_again_at_once() -> None:
    dialogue, far = begin(Read(0x1017))
    for _ in range(ATTEMPTS + 1):
        dialogue.ask_again(bytes.fromhex("4f17100005000000"), 0.0)
    dialogue.ask_again(bytes.fromhex("4f16100005000000"), 0.0)  # the answer to something else
    assert far.take() == ["4017100000000000"] * (ATTEMPTS + 2)
    answer(dialogue, "4f17100006000000")
    assert dialogue.result == b"\6"


def test_upload_in_segments() -> None:
    dialogue, far = begin(Read(0x2002))
    answer(dialogue, "410220000a000000")
    answer(dialogue, "0061626364656667")
    answer(dialogue, "0061626364656667")  # the same again: its toggle bit has had its turn
    answer(dialogue, "1968696a00000000")
    assert far.take() == ["4002200000000000", "6000000000000000", "7000000000000000"]
    assert dialogue.result == b"abcdefghij"


@pytest.mark.parametrize(
    ("data", "sent"),
    [(b"\1", "2f17100001000000"), (b"\1\2", "2b17100001020000"), (b"\1\2\3\4", "2317100001020304")],
)
def test_expedited_download(data: bytes, sent: str) -> None:
    dialogue, far = begin(Write(0x1017, 0, data))
    assert far.take() == [sent]
    answer(dialogue, "6018100000000000")  # to somebody else's download
    assert not dialogue.done
    answer(dialogue, "6017100000000000")
    assert dialogue.done


def test_answers_to_others_are_passed_over() -> None:
    dialogue, _ = begin(Read(0x1017))
    for text in ("4f18100005000000", "4f17100105000000", "6017100000000000", "0012345678901234", "8018100011000906"):
        answer(dialogue, text)
    dialogue.take(b"\x4f\x17\x10", 0.0)
    assert not dialogue.done
    answer(dialogue, "4f17100005000000")
    assert dialogue.result == b"\5"


def test_abort_of_the_object_ends_the_dialogue() -> None:
    dialogue, _ = begin(Read(0x1018, 4))
    answer(dialogue, "8018100411000906")
    assert isinstance(dialogue.error, SdoAbortedError)
    assert dialogue.error.code == Abort.NO_SUBINDEX
    assert str(dialogue.error) == "object 1018h:4: abort 06090011h, no subindex"


def test_abort_of_the_transfer_begins_it_again() -> None:
    dialogue, far = begin(Read(0x1017))
    answer(dialogue, "8000000000000305")
    assert far.take() == ["4017100000000000"] * 2
    answer(dialogue, "4f17100005000000")
    assert dialogue.result == b"\5"


def test_silence_is_asked_again_and_then_an_error() -> None:
    """Three attempts of 0.3 s each."""
    dialogue, far = begin(Read(0x1017))
    asked = ["4017100000000000"]
    assert dialogue.asked_s == 0.0
    for again_s in (0.3, 0.6):
        dialogue.tick(again_s - 0.001)
        assert far.take() == asked
        dialogue.tick(again_s)
        assert dialogue.asked_s == again_s
        asked = ["8017100000000405", "4017100000000000"]
    assert not dialogue.done
    dialogue.tick(0.9)
    assert far.take() == [*asked, "8017100000000405"]
    assert dialogue.done
    assert isinstance(dialogue.error, SdoTimeoutError)
    assert str(dialogue.error) == "no answer to object 1017h:0"
    answer(dialogue, "4f17100005000000")  # too late
    dialogue.tick(2.0)
    assert dialogue.result is None
    assert far.take() == []


def test_each_transfer_of_a_dialogue_has_all_its_attempts() -> None:
    def steps() -> Generator[Transfer, bytes, bytes]:
        return (yield Read(0x2000)) + (yield Read(0x2001, 2))

    far = Far()
    dialogue = SdoDialogue(5, steps(), far, 0.0, attempts=2)
    dialogue.tick(0.3)
    answer(dialogue, "4f00200007000000", 0.4)
    assert dialogue.asked_s == 0.4
    far.take()
    dialogue.tick(0.69)
    assert far.take() == []
    dialogue.tick(0.7)
    assert far.take() == ["8001200200000405", "4001200200000000"]
    answer(dialogue, "4f01200208000000", 0.9)
    assert dialogue.result == b"\7\x08"


def test_a_segment_that_does_not_come_begins_the_upload_anew() -> None:
    dialogue, far = begin(Read(0x2002))
    answer(dialogue, "410220000a000000", 0.1)
    answer(dialogue, "0061626364656667", 0.2)
    far.take()
    dialogue.tick(0.49)
    assert far.take() == []
    dialogue.tick(0.5)  # 0.3 s after the second segment was asked for
    assert far.take() == ["8002200000000405", "4002200000000000"]
    answer(dialogue, "1968696a00000000", 0.5)  # no upload has begun again
    assert not dialogue.done
    answer(dialogue, "4102200003000000", 0.5)
    answer(dialogue, "0978797a00000000", 0.5)
    assert far.take() == ["6000000000000000"]
    assert dialogue.result == b"xyz"


def test_a_dialogue_of_one_attempt_ends_at_the_first_silence_and_at_the_first_abort_of_a_transfer() -> None:
    for end in (lambda each: each.tick(0.3), lambda each: answer(each, "8017100001000405", 0.1)):
        dialogue = SdoDialogue(5, one(Read(0x1017)), Far(), 0.0, attempts=1)
        end(dialogue)
        assert isinstance(dialogue.error, SdoTimeoutError)


def test_transfer_without_end_is_left() -> None:
    dialogue, far = begin(Read(0x1008))
    answer(dialogue, "4108100000000000")
    for place in range(36):
        answer(dialogue, f"{(place & 1) << 4:02x}" + "00" * 7)
    assert not dialogue.done  # 252 bytes
    answer(dialogue, "00" * 8)
    assert dialogue.done
    assert isinstance(dialogue.error, SdoAbortedError)
    assert dialogue.error.code == 0x0504_0005
    assert str(dialogue.error) == "object 1008h:0: abort 05040005h, memory"
    assert far.take()[-1] == "8008100005000405"


def test_the_longest_value_has_256_bytes() -> None:
    dialogue, _ = begin(Read(0x1008))
    answer(dialogue, "4108100000000000")
    for place in range(36):
        answer(dialogue, f"{(place & 1) << 4:02x}" + "61" * 7)
    answer(dialogue, "06" + "62" * 4 + "00" * 3)  # four bytes more, and no word of the end
    assert not dialogue.done
    answer(dialogue, "1f" + "00" * 7)  # the end, without a byte
    assert dialogue.result == b"a" * 252 + b"b" * 4


@pytest.mark.parametrize("code", ["00000006", "ffffffff"])
def test_codes_from_0600_0000h_on_are_of_the_object(code: str) -> None:
    dialogue, far = begin(Read(0x1017))
    answer(dialogue, "80171000" + code)
    assert isinstance(dialogue.error, SdoAbortedError)
    named = int.from_bytes(bytes.fromhex(code), "little")
    assert str(dialogue.error) == f"object 1017h:0: abort {named:08X}h"
    assert dialogue.error.code == named
    assert far.take() == ["4017100000000000"]


def test_an_abort_that_names_no_object_is_of_the_open_transfer() -> None:
    dialogue, _ = begin(Write(0x1017, 0, b"\1"))
    answer(dialogue, "8000000022000008")
    assert isinstance(dialogue.error, SdoAbortedError)
    assert dialogue.error.code == Abort.STATE


def test_only_answers_of_eight_bytes_count() -> None:
    dialogue, _ = begin(Read(0x1017))
    answer(dialogue, "4f1710000500000000")
    answer(dialogue, "4f171000050000")
    assert not dialogue.done


def test_a_dialogue_may_live_with_an_abort() -> None:
    def steps() -> Generator[Transfer, bytes, str]:
        try:
            yield Read(0x2006)
        except SdoAbortedError:
            return (yield Read(0x2000)).hex()
        return ""

    far = Far()
    dialogue = SdoDialogue(5, steps(), far, 0.0)
    answer(dialogue, "8006200000000206")
    answer(dialogue, "4b00200007000000")
    assert dialogue.result == "0700"


def test_transfer_of_nothing_without_end_is_left() -> None:
    dialogue, _ = begin(Read(0x1008))
    answer(dialogue, "4108100000000000")
    answer(dialogue, "0e00000000000000")
    assert isinstance(dialogue.error, SdoAbortedError)


class Server:
    """A block server of three segments a block that loses what it is told to, and says so."""

    def __init__(self, lost: set[int], room: int = 1 << 30) -> None:
        self.lost, self.room = lost, room
        self.data = bytearray()
        self.answers: list[bytes] = []
        self.seen = self.number = 0
        self.end = b""

    def __call__(self, _cob_id: int, request: bytes) -> int:
        if not self.room:
            return 0
        self.room -= 1
        self.seen += 1
        if request[0] == 0xC6:
            self.answers.append(b"\xa4" + request[1:4] + b"\x03" + bytes(3))
        elif self.end:
            assert request[0] & 0xE3 == 0xC1
            self.data = self.data[: len(self.data) - (request[0] >> 2 & 7)]
            assert int.from_bytes(request[1:3], "little") == CRC_OF_DATA
            self.answers.append(b"\xa1" + bytes(7))
        else:
            number = request[0] & 0x7F
            if number == self.number + 1 and self.seen not in self.lost:
                self.number = number
                self.data += request[1:]
                self.end = request if request[0] & 0x80 else b""
            if number == 3 or request[0] & 0x80:
                self.answers.append(bytes((0xA2, self.number, 3)) + bytes(5))
                self.number = 0
        return 1


DATA = bytes(range(40))
#: CRC-16/XMODEM of 0, 1, … 39, bit by bit.
CRC_OF_DATA = 0
for _byte in DATA:
    CRC_OF_DATA ^= _byte << 8
    for _ in range(8):
        CRC_OF_DATA = (CRC_OF_DATA << 1 ^ (0x1021 if CRC_OF_DATA & 0x8000 else 0)) & 0xFFFF


def run(server: Server) -> SdoDialogue:
    dialogue, now_s = SdoDialogue(5, one(Download(0x1F50, 1, DATA)), server, 0.0), 0.0
    while not dialogue.done:
        while server.answers:
            dialogue.take(server.answers.pop(0), now_s)
        now_s += 0.001
        server.room = 2 if server.room < 100 else server.room
        dialogue.tick(now_s)
    return dialogue


@pytest.mark.parametrize("lost", [set(), {2}, {3}, {4}, {3, 5, 6}, {7}])
def test_download_in_blocks_sends_again_what_was_lost(lost: set[int]) -> None:
    server = Server(lost)
    assert run(server).error is None
    assert server.data == DATA
    assert server.seen >= 1 + 6 + 1


def test_a_full_transmit_queue_slows_a_download_down() -> None:
    server = Server(set(), room=1)
    assert run(server).error is None
    assert server.data == DATA


@pytest.mark.parametrize("size", ["80", "ff"])
def test_a_block_has_at_most_127_segments(size: str) -> None:
    dialogue, far = begin(Download(0x1F50, 1, bytes(2000)))
    far.take()
    answer(dialogue, f"a4501f01{size}000000")
    assert [each[:2] for each in far.take()] == [f"{number:02x}" for number in range(1, 128)]


def test_a_download_whose_blocks_never_come_is_given_up() -> None:
    server = Server(set(range(2, 1000)))
    assert isinstance(run(server).error, SdoTimeoutError)
    assert server.seen < 3 * (2 + 3 * (MOST_LOST + 2))


def test_download_in_segments_where_the_node_refuses_blocks() -> None:
    dialogue, far = begin(Download(0x1F50, 1, bytes(range(10))))
    assert far.take() == ["c6501f010a000000"]
    answer(dialogue, "80501f0101000405")
    assert far.take() == ["21501f010a000000"]
    answer(dialogue, "60501f0100000000")
    assert far.take() == ["0000010203040506"]
    answer(dialogue, "2000000000000000")
    assert far.take() == ["1907080900000000"]
    answer(dialogue, "2000000000000000")  # the answer to the first again
    assert not dialogue.done
    answer(dialogue, "3000000000000000")
    assert (dialogue.done, dialogue.error) == (True, None)
