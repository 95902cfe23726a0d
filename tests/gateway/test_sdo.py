"""SDO transfers as a client: what goes out, what comes back, and what ends a transfer."""

from collections.abc import Generator
from itertools import cycle

import pytest

from dbc import indices as od
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

#: A type whose values are not looked at.
RAW = od.DOMAIN


def both() -> Generator[Transfer, bytes, bytes]:
    return (yield Read(0x2000, 0, RAW)) + (yield Read(0x2001, 2, RAW))


def either() -> Generator[Transfer, bytes, bytes]:
    try:
        return (yield Read(0x2006, 0, RAW))
    except SdoAbortedError:
        return (yield Read(0x2000, 0, RAW))


ASKED, GIVEN_UP = "> 4017100000000000", "> 8017100000000405"
#: Zeros, and segments of them with the toggle bit in turns.
ZEROS = " 00000000000000"
SEGMENTS = [f"< {toggle}{ZEROS}" for _, toggle in zip(range(36), cycle(("00", "10")), strict=False)]
ASKED_SEGMENTS = [f"> {toggle}{ZEROS}" for _, toggle in zip(range(36), cycle(("70", "60")), strict=False)]
FROM_SEGMENTS = [each for pair in zip(SEGMENTS, ASKED_SEGMENTS, strict=True) for each in pair]

#: By what is told: a dialogue, its attempts, and its course: "> frame that goes out", "< answer", "@ time", "=" the
#: value, "!" the error. Between "<" or "@" and the next line nothing else goes out.
COURSES: dict[str, tuple[object, int, list[str]]] = {
    **{
        f"a value in one frame, {answer[:2]}": (
            Read(0x1017, 0, RAW),
            ATTEMPTS,
            [ASKED, f"< {answer}", f"= {value}"],
        )
        for answer, value in (
            ("4f17100005000000", "05"),
            ("4b171000e8030000", "e803"),
            ("4317100001020304", "01020304"),
            ("4217100001020304", "01020304"),
            ("4e17100001020304", "01020304"),  # without a size, its number of unused bytes means nothing
        )
    },
    **{
        f"a value of {len(value) // 2} bytes is written": (
            Write(0x1017, 0, bytes.fromhex(value)),
            ATTEMPTS,
            [f"> {sent}", "< 6018100000000000", "< 6017100000000000", "="],
        )
        for value, sent in (("01", "2f17100001000000"), ("0102", "2b17100001020000"), ("01020304", "2317100001020304"))
    },
    "a value in segments; a segment that comes again has had its turn": (
        Read(0x2002, 0, RAW),
        ATTEMPTS,
        [
            *("> 4002200000000000", "< 410220000a000000", "> 6000000000000000", "< 0061626364656667"),
            *("> 7000000000000000", "< 0061626364656667", "< 1968696a00000000", f"= {b'abcdefghij'.hex()}"),
        ],
    ),
    "answers to others, and of another length": (
        Read(0x1017, 0, RAW),
        ATTEMPTS,
        [
            *(ASKED, "< 4f18100005000000", "< 4f17100105000000", "< 6017100000000000", "< 0012345678901234"),
            *("< 8018100011000906", "< 4f1710000500000000", "< 4f171000050000", "< 4f17100005000000", "= 05"),
        ],
    ),
    "an abort of the object": (
        Read(0x1018, 4, RAW),
        ATTEMPTS,
        ["> 4018100400000000", "< 8018100411000906", "! object 1018h:4: abort 06090011h, no subindex"],
    ),
    "codes from 0600 0000h on are of the object": (
        Read(0x1017, 0, RAW),
        ATTEMPTS,
        [ASKED, "< 8017100000000006", "! object 1017h:0: abort 06000000h"],
    ),
    "the last code": (
        Read(0x1017, 0, RAW),
        ATTEMPTS,
        [ASKED, "< 80171000ffffffff", "! object 1017h:0: abort FFFFFFFFh"],
    ),
    "an abort that names no object is of the open transfer": (
        Write(0x1017, 0, b"\1"),
        ATTEMPTS,
        ["> 2f17100001000000", "< 8000000022000008", "! object 1017h:0: abort 08000022h, state"],
    ),
    "an abort of the transfer begins it again": (
        Read(0x1017, 0, RAW),
        ATTEMPTS,
        [ASKED, "< 8000000000000305", ASKED, "< 4f17100005000000", "= 05"],
    ),
    "silence is asked again, 0.3 s each": (
        Read(0x1017, 0, RAW),
        ATTEMPTS,
        [
            *(ASKED, "@ 0.299", "@ 0.3", GIVEN_UP, ASKED, "@ 0.599", "@ 0.6", GIVEN_UP, ASKED, "@ 0.9", GIVEN_UP),
            *("! no answer to object 1017h:0", "< 4f17100005000000", "@ 2.0"),
        ],
    ),
    "one attempt ends at the first silence": (
        Read(0x1017, 0, RAW),
        1,
        [ASKED, "@ 0.3", GIVEN_UP, "! no answer to object 1017h:0"],
    ),
    "one attempt ends at the first abort of the transfer": (
        Read(0x1017, 0, RAW),
        1,
        [ASKED, "< 8017100001000405", "! no answer to object 1017h:0 but abort 05040001h, command"],
    ),
    **{
        f"what came instead of an answer is named, {came}": (
            Read(0x1017, 0, RAW),
            1,
            [ASKED, f"< {came}", "@ 0.3", GIVEN_UP, f"! no answer to object 1017h:0 but {came.upper()}, {why}"],
        )
        for came, why in (
            ("4f18100205000000", "which is of object 1018h:2"),
            ("8018100211000906", "which is of object 1018h:2"),
            ("6017100000000000", "which answers another request"),
            ("0017100000000000", "which answers another request"),
            ("4b1710", "which has 3 bytes, not 8"),
        )
    },
    "a segment with the wrong toggle bit is named, an earlier frame is not": (
        Read(0x1017, 0, RAW),
        1,
        [
            *(ASKED, "< 4f18100005000000", "< 4117100008000000", f"> 60{ZEROS}", f"< 10{ZEROS}", "@ 0.3", GIVEN_UP),
            f"! no answer to object 1017h:0 but 10{ZEROS.strip()}, which has the wrong toggle bit",
        ],
    ),
    "an answer is decoded by its type": (
        Read(0x1017, 0, od.UNSIGNED16),
        ATTEMPTS,
        [ASKED, "< 4217100091010203", "= 9101"],
    ),
    "an answer that is no value of the type": (
        Read(0x1017, 0, od.UNSIGNED16),
        ATTEMPTS,
        [ASKED, "< 4317100091010203", "! object 1017h:0: expected 2 bytes, got 91 01 02 03"],
    ),
    "an upload that ends early": (
        Read(0x1017, 0, RAW),
        ATTEMPTS,
        [
            *(ASKED, "< 411710000a000000", f"> 60{ZEROS}", "< 0361626364656600"),
            "! object 1017h:0: expected the 10 bytes that the node has told, got 6",
        ],
    ),
    "each transfer has all its attempts": (
        both,
        2,
        [
            *("> 4000200000000000", "@ 0.3", "> 8000200000000405", "> 4000200000000000", "@ 0.4", "< 4f00200007000000"),
            *("> 4001200200000000", "@ 0.69", "@ 0.7", "> 8001200200000405", "> 4001200200000000"),
            *("< 4f01200208000000", "= 0708"),
        ],
    ),
    "a segment that does not come begins the upload anew": (
        Read(0x2002, 0, RAW),
        ATTEMPTS,
        [
            *("> 4002200000000000", "@ 0.1", "< 410220000a000000", "> 6000000000000000", "@ 0.2", "< 0061626364656667"),
            # 0.3 s after the second segment was asked for; no upload has begun again when the last one comes.
            *("> 7000000000000000", "@ 0.49", "@ 0.5", "> 8002200000000405", "> 4002200000000000"),
            *("< 1968696a00000000", "< 4102200003000000", "> 6000000000000000", "< 0978797a00000000", "= 78797a"),
        ],
    ),
    "a dialogue may live with an abort": (
        either,
        ATTEMPTS,
        ["> 4006200000000000", "< 8006200000000206", "> 4000200000000000", "< 4b00200007000000", "= 0700"],
    ),
    "a transfer without end is left": (
        Read(0x1008, 0, RAW),
        ATTEMPTS,
        [
            *("> 4008100000000000", "< 4108100000000000", f"> 60{ZEROS}", *FROM_SEGMENTS, f"< 00{ZEROS}"),
            *("> 8008100005000405", "! object 1008h:0: abort 05040005h, memory"),
        ],
    ),
    "a transfer of nothing without end is left": (
        Read(0x1008, 0, RAW),
        ATTEMPTS,
        [
            *("> 4008100000000000", "< 4108100000000000", f"> 60{ZEROS}", "< 0e00000000000000", "> 8008100005000405"),
            "! object 1008h:0: abort 05040005h, memory",
        ],
    ),
    "the longest value has 256 bytes": (
        Read(0x1008, 0, RAW),
        ATTEMPTS,
        [
            *("> 4008100000000000", "< 4108100000000000", f"> 60{ZEROS}", *FROM_SEGMENTS, "< 0600000000000000"),
            *(f"> 70{ZEROS}", f"< 1f{ZEROS}", f"= {'00' * 256}"),
        ],
    ),
    "a download in segments where the node refuses blocks; an answer that comes again means nothing": (
        Download(0x1F50, 1, bytes(range(10))),
        ATTEMPTS,
        [
            *("> c6501f010a000000", "< 80501f0101000405", "> 21501f010a000000", "< 60501f0100000000"),
            *("> 0000010203040506", "< 2000000000000000", "> 1907080900000000", "< 2000000000000000"),
            *("< 3000000000000000", "="),
        ],
    ),
}


@pytest.mark.parametrize("course", COURSES)
def test_course_of_a_dialogue(course: str) -> None:
    steps, attempts, lines = COURSES[course]
    sent: list[str] = []

    def send(cob_id: int, data: bytes) -> None:
        assert cob_id == 0x605
        sent.append(data.hex())

    now_s, dialogue = 0.0, SdoDialogue(5, steps() if callable(steps) else one(steps), send, 0.0, attempts=attempts)  # type: ignore[arg-type]
    end = next(place for place, line in enumerate(lines) if line[0] in "=!")
    for place, line in enumerate(lines):
        kind, text = line[0], line[1:].replace(" ", "")
        assert kind == ">" or not sent, sent
        assert not dialogue.done or not any(each[0] in "<@" for each in lines[place:end])
        if kind == ">":
            assert sent.pop(0) == text
        elif kind == "<":
            dialogue.take(bytes.fromhex(text), now_s)
        elif kind == "@":
            now_s = float(text)
            dialogue.tick(now_s)
        elif kind == "=":
            assert dialogue.result == bytes.fromhex(text)
        else:
            assert str(dialogue.error) == line[2:]
            assert isinstance(dialogue.error, SdoTimeoutError if line.startswith("! no answer") else SdoAbortedError)
            assert dialogue.result is None
    assert dialogue.done
    assert not sent


def test_a_read_whose_answer_must_not_be_used_is_asked_again_at_once() -> None:
    sent: list[bytes] = []
    dialogue = SdoDialogue(5, one(Read(0x1017, 0, RAW)), lambda _, data: sent.append(data), 0.0)
    for _ in range(ATTEMPTS + 1):
        dialogue.ask_again(bytes.fromhex("4f17100005000000"), 0.1)
    assert dialogue.asked_s == 0.1
    dialogue.ask_again(bytes.fromhex("4f16100005000000"), 0.2)  # the answer to something else
    assert sent == [bytes.fromhex("4017100000000000")] * (ATTEMPTS + 2)
    dialogue.take(bytes.fromhex("4f17100006000000"), 0.2)
    assert dialogue.result == b"\6"


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


@pytest.mark.parametrize("room", [1, 1 << 30])
@pytest.mark.parametrize("lost", [set(), {2}, {3}, {4}, {3, 5, 6}, {7}, set(range(2, 1000))])
def test_download_in_blocks_sends_again_what_was_lost(lost: set[int], room: int) -> None:
    """The transmit queue has room for one request, or for all; blocks that never come whole are given up."""
    server = Server(lost, room)
    dialogue, now_s = SdoDialogue(5, one(Download(0x1F50, 1, DATA)), server, 0.0), 0.0
    while not dialogue.done:
        while server.answers:
            dialogue.take(server.answers.pop(0), now_s)
        now_s += 0.001
        server.room = 2 if server.room < 100 else server.room
        dialogue.tick(now_s)
    if len(lost) > 100:
        assert isinstance(dialogue.error, SdoTimeoutError)
        assert server.seen < 3 * (2 + 3 * (MOST_LOST + 2))
    else:
        assert (dialogue.error, server.data) == (None, DATA)
        assert server.seen >= 1 + 6 + 1


@pytest.mark.parametrize("size", ["80", "ff"])
def test_a_block_has_at_most_127_segments(size: str) -> None:
    sent: list[bytes] = []
    dialogue = SdoDialogue(5, one(Download(0x1F50, 1, bytes(2000))), lambda _, data: sent.append(data), 0.0)
    dialogue.take(bytes.fromhex(f"a4501f01{size}000000"), 0.0)
    assert [each[0] for each in sent[1:]] == list(range(1, 128))
