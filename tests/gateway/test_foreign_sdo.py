"""What the SDO requests of another master mean: the node is busy, or what the proof compares may be written."""

import pytest

from gateway.foreign_sdo import CONFIGURATION, Effect, ForeignClient

COMPARED, OTHER = 0x1A00, 0x2010
DOWNLOAD, SEGMENT, UPLOAD, UPLOAD_SEGMENT, BLOCK_UPLOAD, BLOCK_DOWNLOAD = 0x23, 0x00, 0x40, 0x60, 0xA0, 0xC2


@pytest.fixture
def client() -> ForeignClient:
    return ForeignClient({0x1800: CONFIGURATION, COMPARED: CONFIGURATION})


def ask(client: ForeignClient, command: int, index: int = OTHER, now_s: float = 10.0) -> Effect:
    return client.take(bytes((command,)) + index.to_bytes(2, "little") + bytes(5), now_s)


def test_the_channel_is_left_alone_for_a_twentieth_of_a_second(client: ForeignClient) -> None:
    assert client.free_s == float("-inf")
    ask(client, UPLOAD, now_s=10.0)
    assert client.free_s == pytest.approx(10.05)
    ask(client, UPLOAD, now_s=11.0)
    assert client.free_s == pytest.approx(11.05)


@pytest.mark.parametrize("command", [DOWNLOAD, BLOCK_DOWNLOAD])
def test_writes_of_what_is_compared_are_doubted(client: ForeignClient, command: int) -> None:
    assert ask(client, command, COMPARED) is Effect.DOUBT


@pytest.mark.parametrize("command", [UPLOAD, UPLOAD_SEGMENT, BLOCK_UPLOAD])
@pytest.mark.parametrize("index", [COMPARED, OTHER])
def test_reads_keep_the_node_busy(client: ForeignClient, command: int, index: int) -> None:
    assert ask(client, command, index) is Effect.BUSY


def test_segments_are_of_the_download_before_them(client: ForeignClient) -> None:
    assert ask(client, SEGMENT) is Effect.DOUBT  # its beginning was not heard
    assert ask(client, DOWNLOAD, OTHER) is Effect.BUSY
    assert ask(client, SEGMENT) is Effect.NONE
    ask(client, DOWNLOAD, COMPARED)
    assert ask(client, SEGMENT) is Effect.DOUBT
    ask(client, UPLOAD)
    assert ask(client, SEGMENT) is Effect.DOUBT


def test_a_block_download_of_something_else_is_not_doubted(client: ForeignClient) -> None:
    assert ask(client, BLOCK_DOWNLOAD, OTHER) is Effect.BUSY
    assert ask(client, 0x41) is Effect.BUSY
    assert ask(client, 0x01) is Effect.NONE


@pytest.mark.parametrize(("pause_s", "effect"), [(0.9375, Effect.DOUBT), (1.0, Effect.BUSY)])
def test_a_block_download_ends_when_nothing_comes_for_a_second(
    client: ForeignClient, pause_s: float, effect: Effect
) -> None:
    ask(client, BLOCK_DOWNLOAD, COMPARED, now_s=10.0)
    assert ask(client, 0x41, now_s=10.5) is Effect.DOUBT
    assert ask(client, 0x41, now_s=10.5 + pause_s) is effect


@pytest.mark.parametrize("command", [0x80, 0xA1])
def test_the_node_ends_a_block_download(client: ForeignClient, command: int) -> None:
    ask(client, BLOCK_DOWNLOAD, COMPARED)
    client.take_answer(b"\xa2" + bytes(7))  # a part has come
    assert ask(client, 0x41) is Effect.DOUBT
    client.take_answer(bytes((command,)) + bytes(7))
    assert ask(client, 0x41) is Effect.BUSY


def test_the_master_ends_a_block_download_by_an_abort(client: ForeignClient) -> None:
    ask(client, BLOCK_DOWNLOAD, COMPARED)
    assert ask(client, 0x80) is Effect.BUSY
    assert ask(client, 0x41) is Effect.BUSY


def test_a_download_within_a_block_download_is_read_both_ways(client: ForeignClient) -> None:
    ask(client, BLOCK_DOWNLOAD, OTHER)
    assert ask(client, DOWNLOAD, COMPARED) is Effect.DOUBT
    assert ask(client, DOWNLOAD, OTHER) is Effect.DOUBT  # may be data of what is written
    client.take_answer(b"\xa1" + bytes(7))
    assert ask(client, DOWNLOAD, OTHER) is Effect.BUSY


READ, ANSWER = b"\x40\x09\x20\x00", b"\x43\x09\x20\x00"


def test_an_answer_that_was_under_way_at_a_write_is_old_and_the_next_is_not(client: ForeignClient) -> None:
    client.ask(READ + bytes(4))
    ask(client, DOWNLOAD, OTHER)
    assert not client.take_answer(ANSWER + bytes(4))
    client.ask(READ + bytes(4))
    ask(client, DOWNLOAD, COMPARED)
    client.ask(READ + bytes(4))
    assert client.take_answer(ANSWER + bytes(4))
    assert not client.take_answer(ANSWER + bytes(4))


def test_no_answer_of_before_a_boot_is_expected_after_it(client: ForeignClient) -> None:
    client.ask(READ + bytes(4))
    ask(client, DOWNLOAD, COMPARED)
    client.booted()
    client.ask(READ + bytes(4))
    assert not client.take_answer(ANSWER + bytes(4))
