"""SDO transfers as a client: what goes out, what comes back, and what ends a transfer."""

from collections.abc import Generator

import pytest

from dbc.canopen import Abort
from dbc.contract import LONGEST_VALUE
from gateway.sdo import ATTEMPTS, TIMEOUT_S, Read, SdoAbortedError, SdoDialogue, SdoTimeoutError, Transfer, Write


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


def one(transfer: Transfer) -> Generator[Transfer, bytes, bytes]:
    return (yield transfer)


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
    ],
)
def test_expedited_upload(came: str, value: bytes) -> None:
    dialogue, far = begin(Read(0x1017))
    assert far.take() == ["4017100000000000"]
    answer(dialogue, came)
    assert dialogue.done
    assert dialogue.result == value


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
    dialogue, far = begin(Read(0x1017))
    now_s = 0.0
    for _ in range(ATTEMPTS):
        dialogue.tick(now_s + 0.9 * TIMEOUT_S)
        now_s += TIMEOUT_S
        dialogue.tick(now_s)
    assert isinstance(dialogue.error, SdoTimeoutError)
    assert far.take() == ["4017100000000000", "8017100000000405"] * ATTEMPTS
    answer(dialogue, "4f17100005000000")  # too late
    assert dialogue.result is None


def test_transfer_without_end_is_left() -> None:
    dialogue, far = begin(Read(0x1008))
    answer(dialogue, "4108100000000000")
    for place in range(LONGEST_VALUE):
        answer(dialogue, f"{(place & 1) << 4:02x}" + "00" * 7)
    assert dialogue.done
    assert isinstance(dialogue.error, SdoAbortedError)
    assert far.take()[-1] == "8008100005000405"


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
