"""Questions to devices that other masters ask, too: they wait, and never end another master's transfer."""

import pytest

from commissioning.scan import Scan
from dbc.canopen import HEARTBEAT_BASE, SDO_REQUEST_BASE, SDO_RESPONSE_BASE, SYNC_COB_ID
from dbc.frame import Frames
from gateway.foreign_sdo import SDO_QUIET_S
from gateway.nmt_master import NmtMaster
from gateway.questions import BUSY_S
from gateway.sdo import TIMEOUT_S
from gateway.strangers import AGAIN_S, Strangers
from tests.bus.harness import frame
from tests.gateway.drives import shared_contract

DRIVE = 5
#: A segment of another master's upload.
SEGMENT = b"\x60" + bytes(7)
PRODUCER = b"\x43\x05\x10\x00\x80\x00\x00\x40"


class Asked:
    """The strangers of a bus with one drive, and what they send."""

    def __init__(self) -> None:
        self.sent: list[tuple[int, bytes]] = []
        self.strangers = Strangers(lambda can_id, data: self.sent.append((can_id, data)))
        self.strangers.heard(DRIVE)
        self.strangers.find_producers(0.0)


def test_strangers_are_asked_when_another_master_has_left_the_channel() -> None:
    asked = Asked()
    asked.strangers.take(SDO_REQUEST_BASE, DRIVE, SEGMENT, 0.0)
    asked.strangers.tick(0.01)
    assert asked.sent == []
    asked.strangers.tick(SDO_QUIET_S)
    assert [can_id for can_id, _ in asked.sent] == [SDO_REQUEST_BASE + DRIVE]
    asked.strangers.take(SDO_RESPONSE_BASE, DRIVE, PRODUCER, 0.06)
    assert asked.strangers.tick(0.06)
    assert "node 5 produces SYNC" in asked.strangers.words


def test_who_produces_sync_is_told_once() -> None:
    asked = Asked()
    told = []
    for now_s in (0.0, 2 * AGAIN_S, 4 * AGAIN_S):
        asked.strangers.find_producers(now_s)
        asked.strangers.tick(now_s)
        asked.strangers.take(SDO_RESPONSE_BASE, DRIVE, PRODUCER, now_s)
        told.append(asked.strangers.tick(now_s))
    assert told == [True, False, False]
    assert len(asked.sent) == 3


@pytest.mark.parametrize("base", [SDO_REQUEST_BASE, SDO_RESPONSE_BASE])
def test_a_block_upload_of_another_master_keeps_the_channel(base: int) -> None:
    asked = Asked()
    asked.strangers.take(base, DRIVE, SEGMENT, 0.0)
    asked.strangers.tick(0.01)
    assert asked.sent == []


def test_a_question_that_another_master_interrupts_ends_without_an_abort() -> None:
    asked = Asked()
    asked.strangers.tick(0.0)
    asked.strangers.take(SDO_REQUEST_BASE, DRIVE, SEGMENT, 0.1)
    for now_s in (0.11, 0.12, 2 * TIMEOUT_S):
        asked.strangers.take(SDO_REQUEST_BASE, DRIVE, SEGMENT, now_s)
        asked.strangers.tick(now_s)
    assert [data[0] for _, data in asked.sent] == [0x40]


def test_strangers_that_are_always_busy_are_given_up() -> None:
    asked = Asked()
    ended = []
    for turn in range(round(BUSY_S / 0.01) + 2):
        asked.strangers.take(SDO_REQUEST_BASE, DRIVE, SEGMENT, 0.01 * turn)
        ended.append(asked.strangers.tick(0.01 * turn))
    assert asked.sent == []
    assert ended.count(True) == 1


def mastered() -> tuple[NmtMaster, list[tuple[int, bytes]]]:
    """Return the master of a bus that drives share, and the list of what it sends."""
    sent: list[tuple[int, bytes]] = []
    contract = shared_contract()
    return NmtMaster(contract, 0, lambda *it: sent.append(it), lambda *_: None, lambda _: None), sent


@pytest.mark.parametrize(
    ("can_id", "data"),
    [(0x7E5, bytes(8)), (0x7E4, b"\x11" + bytes(7)), (HEARTBEAT_BASE, b"\x05"), (HEARTBEAT_BASE + DRIVE, bytes(2))],
)
def test_what_is_no_heartbeat_makes_no_stranger(can_id: int, data: bytes) -> None:
    master, sent = mastered()
    master.take(frame(can_id, data), 0.0)
    master.strangers.find_producers(0.0)
    master.strangers.tick(1.0)
    assert sent == []


def test_the_master_lets_another_master_finish_with_a_stranger() -> None:
    master, sent = mastered()
    master.take(frame(HEARTBEAT_BASE + DRIVE, b"\x05"), 0.0)
    master.take(frame(SDO_REQUEST_BASE + DRIVE, SEGMENT), 0.0)
    master.strangers.find_producers(0.0)
    master.strangers.tick(0.01)
    assert sent == []
    master.strangers.tick(SDO_QUIET_S)
    assert sent == [(SDO_REQUEST_BASE + DRIVE, b"\x40\x05\x10\x00\x00\x00\x00\x00")]


def test_a_scan_drops_a_dialogue_that_another_master_interrupts() -> None:
    sent: list[Frames] = []
    scan = Scan(lambda burst: sent.append(burst) or len(burst), 1_000_000, 0.0, listen_s=0.1)
    scan.take(frame(SYNC_COB_ID), 0.0)
    now_s = 0.1
    while not sent:
        scan.tick(now_s)
    first = int(sent[0]["can_id"][0]) - SDO_REQUEST_BASE
    while now_s < 1.0:
        now_s += 0.01
        scan.take(frame(SDO_REQUEST_BASE + first, SEGMENT), now_s)
        scan.tick(now_s)
    assert sum(int(each["can_id"][0]) == SDO_REQUEST_BASE + first for each in sent) == 1
