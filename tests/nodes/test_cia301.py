"""CiA 301 to the letter: each row is a request and the answer that the standard asks for."""

import struct

from dbc.canopen import HEARTBEAT_BASE, Abort, NmtState
from nodes.segment import Segment
from tests.bus.harness import frame
from tests.nodes.helpers import ArrayLink, give, read, sdo, sync, write

START_1 = bytes((1, 1))


def code(answer: bytes) -> int:
    assert answer[0] == 0x80, answer.hex()
    return int(struct.unpack("<I", answer[4:])[0])


def request(segment: Segment, link: ArrayLink, text: str) -> bytes:
    return sdo(segment, link, 1, bytes.fromhex(text.replace(" ", "")))


def test_emcy_identifier_changes_only_while_it_is_off(segment: Segment, link: ArrayLink) -> None:
    assert write(segment, link, 0x1014, 0, 0xA1, 4) == Abort.STATE
    assert write(segment, link, 0x1014, 0, 0x8000_00A1, 4) == 0
    assert write(segment, link, 0x1014, 0, 0xA1, 4) == 0
    assert write(segment, link, 0x1014, 0, 0xA1 | 1 << 29, 4) == Abort.VALUE


def test_overflow_changes_only_without_a_period(segment: Segment, link: ArrayLink) -> None:
    assert write(segment, link, 0x1019, 0, 20, 1) == Abort.STATE
    assert write(segment, link, 0x1006, 0, 0, 4) == 0
    assert write(segment, link, 0x1019, 0, 20, 1) == 0
    assert write(segment, link, 0x1019, 0, 1, 1) == Abort.VALUE
    assert write(segment, link, 0x1019, 0, 241, 1) == Abort.VALUE


def test_error_field_without_errors_has_no_data(segment: Segment, link: ArrayLink) -> None:
    assert read(segment, link, 1, 0x1003, 0) == 0
    assert code(request(segment, link, "40 03 10 01")) == Abort.NO_DATA


def test_variable_has_no_subindex_but_0(segment: Segment, link: ArrayLink) -> None:
    assert code(request(segment, link, "40 00 30 00")) == Abort.NO_OBJECT
    for index in (0x1000, 0x1001, 0x1017, 0x2000, 0x2021):
        place = index.to_bytes(2, "little").hex()
        for text in (f"40 {place} 01", f"2f {place} 01 00"):
            assert code(request(segment, link, text)) == Abort.NO_SUBINDEX


def test_entry_for_a_node_id_above_127_is_not_used(segment: Segment, link: ArrayLink) -> None:
    assert write(segment, link, 0x1016, 1, 0x00E4_01F4, 4) == 0
    give(segment, link, frame(HEARTBEAT_BASE + 0x64, b"\5"))
    segment.tick(1e3)
    assert 0x81 not in link.take_sent()["can_id"]


def test_expedited_download_may_leave_out_its_size(segment: Segment, link: ArrayLink) -> None:
    assert request(segment, link, "22 17 10 00 E8 03 00 00")[0] == 0x60
    assert read(segment, link, 1, 0x1017) == 1000
    assert request(segment, link, "22 21 20 00 02 00 00 00")[0] == 0x60
    assert read(segment, link, 1, 0x2021) == 2


def test_blocks_are_refused_but_an_upload_may_become_an_ordinary_one(segment: Segment, link: ArrayLink) -> None:
    for text in ("A0 17 10 00 7F 00", "A0 08 10 00 7F 03", "C2 17 10 00 02 00 00 00"):
        assert code(request(segment, link, text)) == Abort.COMMAND
    answer = request(segment, link, "A0 17 10 00 7F 04")
    assert (answer[0] & 0xE0, answer[4:6]) == (0x40, (1000).to_bytes(2, "little"))


def test_segment_after_the_end_belongs_to_nothing(segment: Segment, link: ArrayLink) -> None:
    assert request(segment, link, "40 08 10 00")[0] == 0x41
    value, toggle = b"", 0
    while True:
        answer = request(segment, link, f"{0x60 | toggle:02x}")
        value += answer[1 : 8 - (answer[0] >> 1 & 7)]
        toggle ^= 0x10
        if answer[0] & 1:
            break
    assert value == b"canskin SBHE block"
    for command in ("60", "70"):
        assert code(request(segment, link, command)) == Abort.COMMAND


def test_segment_after_an_abort_belongs_to_nothing(segment: Segment, link: ArrayLink) -> None:
    request(segment, link, "40 08 10 00")
    assert give(segment, link, frame(0x601, bytes.fromhex("8008100000000405"))) == []
    assert code(request(segment, link, "60")) == Abort.COMMAND
    request(segment, link, "40 08 10 00")
    assert code(request(segment, link, "70")) == Abort.TOGGLE
    assert code(request(segment, link, "60")) == Abort.COMMAND


def test_download_segment_without_a_download(segment: Segment, link: ArrayLink) -> None:
    assert code(request(segment, link, "01 05")) == Abort.COMMAND
    request(segment, link, "40 08 10 00")  # an upload is no download
    assert code(request(segment, link, "01 05")) == Abort.COMMAND


def test_download_in_segments_ends_with_its_last(segment: Segment, link: ArrayLink) -> None:
    assert request(segment, link, "21 17 10 00 02 00 00 00")[0] == 0x60
    assert request(segment, link, "0B F4 01")[0] == 0x20
    assert read(segment, link, 1, 0x1017) == 500
    assert code(request(segment, link, "1B F4 01")) == Abort.COMMAND


def test_nmt_command_has_two_bytes(segment: Segment, link: ArrayLink) -> None:
    link.take_sent()
    give(segment, link, *(frame(0, data) for data in (b"\1", b"\1\1\0", bytes((1, 1, 0, 0, 0, 0, 0, 0)), b"")))
    segment.tick(2.0)
    states = {int(each["data"][0]) for each in link.take_sent() if each["can_id"] == HEARTBEAT_BASE + 1}
    assert states == {NmtState.PRE_OPERATIONAL}


def test_sync_counter_outside_1_to_240_calls_for_nothing(segment: Segment, link: ArrayLink) -> None:
    give(segment, link, frame(0, START_1))
    assert give(segment, link, *map(sync, (0, 241, 255))) == []
    assert segment.syncs_seen == 0
    assert len(give(segment, link, sync(240))) == 2
