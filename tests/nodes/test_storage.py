"""Reset, store and restore in Python and C: dictionary and electronics agree; a folder outlives the process."""

import json
import struct
from pathlib import Path
from typing import NoReturn

import pytest

from canskin.errors import InputError
from dbc import indices as od
from dbc.canopen import Abort
from dbc.contract import Contract
from nodes.storage import Storage
from tests.bus.harness import frame
from tests.nodes.helpers import (
    RESET_COMMUNICATION,
    RESET_NODE,
    START,
    ArrayLink,
    give,
    new_segment,
    read,
    sdo,
    sync,
    write,
    write_request,
)

SAVE, LOAD = 0x6576_6173, 0x6461_6F6C


class Board:
    """The first nodes of bus0."""

    def __init__(self, contract: Contract, store: Path | None = None, *, in_c: bool) -> None:
        self.link, self.counter = ArrayLink(), 0
        self.segment = new_segment(contract, self.link, {1, 2}, store=store, in_c=in_c)

    def write(self, index: int, subindex: int, value: int, size: int) -> int:
        return write(self.segment, self.link, index, subindex, value, size)

    def read(self, index: int, subindex: int = 0) -> int:
        return read(self.segment, self.link, 1, index, subindex)

    def reset(self, command: int = RESET_NODE) -> None:
        give(self.segment, self.link, frame(0, bytes((command, 1))))

    def sums(self, node_id: int = 1) -> list[bytes]:
        """Return what the frames of node 1 or 2 carry now."""
        self.counter += 1
        give(self.segment, self.link, frame(0, bytes((START, 0))))
        sent = give(self.segment, self.link, sync(self.counter))
        return [payload[1:] for can_id, payload in sent if can_id & 0x7F == node_id]


@pytest.fixture
def board(contract: Contract, in_c: bool) -> Board:
    return Board(contract, in_c=in_c)


def test_a_reset_ends_calibration_and_pattern_of_one_node(board: Board) -> None:
    sums = board.sums()
    sdo(board.segment, board.link, 2, write_request(od.OFFSET, 3, (100).to_bytes(2, "little")))
    other = board.sums(2)
    seen = [sums]
    for index, subindex, value, size in (
        (od.OFFSET, 3, 100, 2),
        (od.GAIN, 4, int.from_bytes(struct.pack("<f", 0.5), "little"), 4),
        (od.TEST_PATTERN, 0, 2, 1),
    ):
        assert board.write(index, subindex, value, size) == 0
        assert board.sums() not in seen
        seen.append(board.sums())
    board.reset()
    assert (board.read(od.OFFSET, 3), board.read(od.TEST_PATTERN)) == (0, 0)
    assert (board.sums(), board.sums(2)) == (sums, other)


def test_reset_communication_leaves_calibration_and_pattern(board: Board) -> None:
    board.write(od.OFFSET, 3, 100, 2)
    sums = board.sums()
    board.write(od.TEST_PATTERN, 0, 3, 1)
    board.reset(RESET_COMMUNICATION)
    assert (board.read(od.OFFSET, 3), board.read(od.TEST_PATTERN)) == (100, 3)
    board.write(od.TEST_PATTERN, 0, 0, 1)
    assert board.sums() == sums


def test_stored_values_come_back_at_a_reset_until_defaults_are_restored(board: Board) -> None:
    plain = board.sums()
    board.write(od.OFFSET, 3, 100, 2)
    stored = board.sums()
    board.write(od.TEST_PATTERN, 0, 2, 1)  # is never stored
    board.write(od.STORE, 1, SAVE, 4)
    board.write(od.OFFSET, 3, 7, 2)
    board.reset()
    assert (board.read(od.OFFSET, 3), board.read(od.TEST_PATTERN), board.sums()) == (100, 0, stored)
    for _ in range(2):  # also when nothing is stored
        assert board.write(od.RESTORE, 1, LOAD, 4) == 0
        assert board.sums() == stored
        board.reset()
        assert (board.read(od.OFFSET, 3), board.sums()) == (0, plain)
        board.write(od.OFFSET, 3, 100, 2)


def test_a_reset_of_communication_brings_stored_communication_back_alone(board: Board) -> None:
    for index, subindex in ((od.HEARTBEAT_MS, 0), (od.OFFSET, 3)):
        board.write(index, subindex, 100, 2)
    board.write(od.STORE, 1, SAVE, 4)
    board.write(od.HEARTBEAT_MS, 0, 700, 2)
    board.write(od.OFFSET, 3, 7, 2)
    board.reset(RESET_COMMUNICATION)
    assert (board.read(od.HEARTBEAT_MS), board.read(od.OFFSET, 3)) == (100, 7)


def test_folder_outlives_the_process(contract: Contract, in_c: bool, tmp_path: Path) -> None:
    first = Board(contract, tmp_path, in_c=in_c)
    first.write(od.OFFSET, 3, 100, 2)
    first.write(od.HEARTBEAT_MS, 0, 400, 2)
    first.write(od.STORE, 1, SAVE, 4)
    assert [path.name for path in tmp_path.iterdir()] == ["bus0-1.json"]
    for language in (False, in_c):
        second = Board(contract, tmp_path, in_c=language)
        assert (second.read(od.OFFSET, 3), second.read(od.HEARTBEAT_MS)) == (100, 400)
        assert second.sums() == first.sums()
    second.write(od.RESTORE, 1, LOAD, 4)
    assert not list(tmp_path.iterdir())
    assert Board(contract, tmp_path, in_c=in_c).read(od.OFFSET, 3) == 0


@pytest.mark.parametrize(
    ("method", "order"), [("replace", (od.STORE, 1, SAVE, 4)), ("unlink", (od.RESTORE, 1, LOAD, 4))]
)
def test_a_folder_that_cannot_be_changed_is_an_abort_and_loses_nothing(
    contract: Contract,
    in_c: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    method: str,
    order: tuple[int, int, int, int],
) -> None:
    board = Board(contract, tmp_path, in_c=in_c)
    board.write(od.OFFSET, 3, 100, 2)
    board.write(od.STORE, 1, SAVE, 4)
    board.write(od.OFFSET, 3, 7, 2)

    def refuse(*_: object, **__: object) -> NoReturn:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, method, refuse)
    assert board.write(*order) == Abort.HARDWARE
    monkeypatch.undo()
    board.reset()
    assert (board.read(od.OFFSET, 3), Board(contract, tmp_path, in_c=in_c).read(od.OFFSET, 3)) == (100, 100)


def test_what_does_not_fit_the_dictionary_is_not_restored(contract: Contract, in_c: bool, tmp_path: Path) -> None:
    """A file that was written by hand can put nothing into a node that an SDO write could not."""
    parameters = {
        0x1000: {0: b"\1\0\0\0"},
        0x1017: {0: b"\1"},
        0x1029: {1: b"\x09"},
        0x1A00: {1: bytes.fromhex("10c80021")},
        0x1A01: {0: b"\5", 5: bytes.fromhex("10050021")},  # one sum more than a classic frame holds
        0x5000: {0: b"\1"},
        od.GAIN: {3: b"\0\0\xc0\x7f"},
        od.TEST_PATTERN: {0: b"\2"},
    }
    Storage(contract.phi.fingerprint, tmp_path / "bus0-1.json").save(parameters)
    board = Board(contract, tmp_path, in_c=in_c)
    assert (board.read(0x1000), board.read(od.HEARTBEAT_MS), board.read(od.TEST_PATTERN)) == (0, 1000, 0)
    assert (board.read(0x1029, 1), board.read(od.GAIN, 3)) == (0, int.from_bytes(struct.pack("<f", 1), "little"))
    assert board.sums() == []  # both are mapped wrongly


@pytest.mark.parametrize(
    "content",
    [
        "",
        "[]",
        '{"phi": 3}',
        '{"phi": "x", "parameters": {"zz": "00"}}',
        '{"phi": "abc", "parameters": {}, "more": 1}',
        '{"phi": "abc", "parameters": {"1017:0": "00"}}',
        '{"phi": "abc", "parameters": {"1017:0a": "00"}}',
        '{"phi": "abc", "parameters": {"1017:00": "AB"}}',
        '{"phi": "x", "parameters": {"-1:0": "00"}}',
        '{"phi": "x", "parameters": {"1017:00": "e80"}}',
        "\0\1\2",
    ],
)
def test_file_that_no_node_stored_is_refused(tmp_path: Path, content: str) -> None:
    (tmp_path / "bus0-1.json").write_text(content)
    with pytest.raises(InputError, match=r"bus0-1\.json: expected parameters"):
        Storage("abc", tmp_path / "bus0-1.json")


def test_parameters_of_another_skin_are_refused(tmp_path: Path) -> None:
    Storage("abc", tmp_path / "bus0-1.json").save({0x1017: {0: b"\1\0"}})
    with pytest.raises(InputError, match="expected parameters of a skin with Φ def, got Φ abc"):
        Storage("def", tmp_path / "bus0-1.json")


def test_the_file_names_each_object_in_hexadecimal(tmp_path: Path) -> None:
    path = tmp_path / "bus0-1.json"
    parameters = {0x1017: {0: b"\x90\1"}, 0x2010: {1: b"\0\0\x80\x3f", 0x1F: b"\0\0\0\x40"}, 0x2011: {0xA: b""}}
    Storage("abc", path).save(parameters)
    assert json.loads(path.read_text()) == {
        "phi": "abc",
        "parameters": {"1017:00": "9001", "2010:01": "0000803f", "2010:1F": "00000040", "2011:0A": ""},
    }
    assert Storage("abc", path).parameters == parameters


def test_a_file_that_cannot_be_read_is_named_with_the_reason(tmp_path: Path) -> None:
    (tmp_path / "bus0-1.json").mkdir()
    with pytest.raises(InputError, match=r"bus0-1\.json: cannot read the stored parameters: Is a directory"):
        Storage("abc", tmp_path / "bus0-1.json")


def test_the_values_of_another_node_id_are_deleted(tmp_path: Path) -> None:
    storage = Storage("abc", tmp_path / "bus0-1.json", own=1)
    values = {0x1017: {0: b"\1\0"}}
    storage.save(values)
    storage.save_node_id(1)
    assert Storage("abc", tmp_path / "bus0-1.json", own=1).parameters == values
    storage.save_node_id(2)
    kept = Storage("abc", tmp_path / "bus0-1.json", own=1)
    assert (kept.parameters, kept.node_id, kept.owner) == ({}, 2, 2)
    kept.save(values)
    kept.save_node_id(255)
    assert not (tmp_path / "bus0-1.json").exists()
