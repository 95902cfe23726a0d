"""What the SDO requests of another master mean: the node is busy, or what the proof compares may be written."""

import pytest

from gateway.foreign_sdo import CONFIGURATION, Effect, ForeignClient

COMPARED, OTHER = 0x1A00, 0x2010
#: First bytes of requests; of one whose number of a block's segment is 0x41 or 1.
DOWNLOAD, SEGMENT, UPLOAD, UPLOAD_SEGMENT, BLOCK_UPLOAD, BLOCK_DOWNLOAD = 0x23, 0x00, 0x40, 0x60, 0xA0, 0xC2
IN_BLOCK, ABORT = 0x41, 0x80
DOUBT, BUSY, NONE = Effect.DOUBT, Effect.BUSY, Effect.NONE
#: An answer that ends or refuses a block download, and one that says that a part has come.
TAKEN, REFUSED, PART = 0xA1, 0x80, 0xA2
READ, ANSWER = b"\x40\x09\x20\x00" + bytes(4), b"\x43\x09\x20\x00" + bytes(4)


@pytest.fixture
def client() -> ForeignClient:
    return ForeignClient({0x1800: CONFIGURATION, COMPARED: CONFIGURATION})


def ask(client: ForeignClient, command: int, index: int = OTHER, now_s: float = 10.0) -> Effect:
    return client.take(bytes((command,)) + index.to_bytes(2, "little") + bytes(5), now_s)


def test_the_channel_is_left_alone_for_a_twentieth_of_a_second(client: ForeignClient) -> None:
    assert client.free_s == float("-inf")
    for now_s in (10.0, 11.0):
        ask(client, UPLOAD, now_s=now_s)
        assert client.free_s == pytest.approx(now_s + 0.05)


#: Requests with their effects, and answers of the node, whose effect is None.
COURSES = {
    "writes of what is compared": [(DOWNLOAD, COMPARED, DOUBT)],
    "a block of what is compared": [(BLOCK_DOWNLOAD, COMPARED, DOUBT)],
    "reads": [(each, index, BUSY) for each in (UPLOAD, UPLOAD_SEGMENT, BLOCK_UPLOAD) for index in (COMPARED, OTHER)],
    "segments are of the download before them; the first, whose beginning was not heard, may be of anything": [
        *((SEGMENT, OTHER, DOUBT), (DOWNLOAD, OTHER, BUSY), (SEGMENT, OTHER, NONE), (DOWNLOAD, COMPARED, DOUBT)),
        *((SEGMENT, OTHER, DOUBT), (UPLOAD, OTHER, BUSY), (SEGMENT, OTHER, DOUBT)),
    ],
    "a block download of something else": [
        *((BLOCK_DOWNLOAD, OTHER, BUSY), (IN_BLOCK, OTHER, BUSY), (0x01, OTHER, NONE)),
    ],
    **{
        f"the node ends a block download with {end:X}h": [
            *((BLOCK_DOWNLOAD, COMPARED, DOUBT), (PART, 0, None), (IN_BLOCK, OTHER, DOUBT), (end, 0, None)),
            (IN_BLOCK, OTHER, BUSY),
        ]
        for end in (TAKEN, REFUSED)
    },
    "the master ends a block download": [
        *((BLOCK_DOWNLOAD, COMPARED, DOUBT), (ABORT, OTHER, BUSY), (IN_BLOCK, OTHER, BUSY)),
    ],
    "a download within a block download is read both ways": [
        *((BLOCK_DOWNLOAD, OTHER, BUSY), (DOWNLOAD, COMPARED, DOUBT), (DOWNLOAD, OTHER, DOUBT), (TAKEN, 0, None)),
        (DOWNLOAD, OTHER, BUSY),
    ],
}


@pytest.mark.parametrize("course", COURSES)
def test_what_requests_mean(client: ForeignClient, course: str) -> None:
    for command, index, effect in COURSES[course]:
        if effect is None:
            client.take_answer(bytes((command,)) + bytes(7))
        else:
            assert ask(client, command, index) is effect


@pytest.mark.parametrize(("pause_s", "effect"), [(0.9375, DOUBT), (1.0, BUSY)])
def test_a_block_download_ends_when_nothing_comes_for_a_second(
    client: ForeignClient, pause_s: float, effect: Effect
) -> None:
    ask(client, BLOCK_DOWNLOAD, COMPARED, now_s=10.0)
    assert ask(client, IN_BLOCK, now_s=10.5) is DOUBT
    assert ask(client, IN_BLOCK, now_s=10.5 + pause_s) is effect


def test_an_answer_that_was_under_way_at_a_write_is_old_and_the_next_is_not(client: ForeignClient) -> None:
    client.ask(READ)
    ask(client, DOWNLOAD, OTHER)
    assert not client.take_answer(ANSWER)
    client.ask(READ)
    ask(client, DOWNLOAD, COMPARED)
    client.ask(READ)
    assert [client.take_answer(ANSWER) for _ in range(2)] == [True, False]
    client.ask(READ)
    ask(client, DOWNLOAD, COMPARED)
    client.booted()  # no older answer comes
    client.ask(READ)
    assert not client.take_answer(ANSWER)
