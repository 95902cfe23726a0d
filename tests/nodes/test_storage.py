"""Reset, store and restore: dictionary and electronics go together, and a folder outlives the process."""

import json
import struct
from pathlib import Path

import pytest

from canskin.errors import InputError
from dbc import indices as od
from dbc.canopen import Abort
from dbc.contract import Contract
from nodes.electronics import Electronics
from nodes.sampler import Sampler
from nodes.storage import Storage
from tests.bus.harness import frame
from tests.nodes.helpers import RESET_COMMUNICATION, RESET_NODE, ArrayLink, Still, give, new_segment, read, sync, write

SAVE, LOAD = 0x6576_6173, 0x6461_6F6C


class Board:
    """Nodes 1 and 2 of bus0 and what their taxels are made of."""

    def __init__(self, contract: Contract, store: Path | None = None) -> None:
        self.electronics = Electronics(contract.layout.taxels, noise_n=0.0)
        self.sampler = Sampler(contract.phi, Still(contract), self.electronics)
        self.link = ArrayLink()
        self.segment = new_segment(contract, self.link, {1, 2}, sampler=self.sampler, store=store)
        self.chain = contract.phi.order[: contract.phi.block_size]

    def write(self, index: int, subindex: int, value: int, size: int) -> int:
        return write(self.segment, self.link, index, subindex, value, size)

    def read(self, index: int, subindex: int = 0) -> int:
        return read(self.segment, self.link, 1, index, subindex)

    def reset(self, command: int = RESET_NODE) -> None:
        give(self.segment, self.link, frame(0, bytes((command, 1))))

    @property
    def offset(self) -> float:
        """What the electronics add to the taxel at place 3."""
        return float(self.electronics.offset[self.chain[2]])


@pytest.fixture
def board(contract: Contract) -> Board:
    return Board(contract)


def test_reset_takes_calibration_and_pattern_from_the_electronics(board: Board) -> None:
    sums = board.sampler.sample(1, 0).copy()
    board.write(od.OFFSET, 3, 100, 2)
    board.write(od.GAIN, 4, int.from_bytes(struct.pack("<f", 0.5), "little"), 4)
    board.write(od.TEST_PATTERN, 0, 2, 1)
    assert (board.sampler.sample(2, 10**9) != sums)[:8].any()
    board.reset()
    assert (board.read(od.OFFSET, 3), board.read(od.TEST_PATTERN), board.offset) == (0, 0, 0.0)
    assert (board.sampler.sample(3, 2 * 10**9) == sums).all()


def test_reset_communication_leaves_calibration_and_pattern(board: Board) -> None:
    board.write(od.OFFSET, 3, 100, 2)
    board.write(od.TEST_PATTERN, 0, 3, 1)
    board.reset(RESET_COMMUNICATION)
    assert (board.read(od.OFFSET, 3), board.offset) == (100, 100.0)
    assert (board.read(od.TEST_PATTERN), board.sampler.pattern(0)) == (3, 3)


def test_stored_values_come_back_at_a_reset_until_defaults_are_restored(board: Board) -> None:
    board.write(od.OFFSET, 3, 100, 2)
    board.write(od.TEST_PATTERN, 0, 2, 1)  # is never stored
    board.write(od.STORE, 1, SAVE, 4)
    board.write(od.OFFSET, 3, 7, 2)
    board.reset()
    assert (board.read(od.OFFSET, 3), board.offset) == (100, 100.0)
    assert (board.read(od.TEST_PATTERN), board.sampler.pattern(0)) == (0, 0)
    for _ in range(2):  # also when nothing is stored
        assert board.write(od.RESTORE, 1, LOAD, 4) == 0
        assert board.offset == 100.0
        board.reset()
        assert (board.read(od.OFFSET, 3), board.offset) == (0, 0.0)
        board.write(od.OFFSET, 3, 100, 2)


def test_other_nodes_keep_their_calibration(board: Board, contract: Contract) -> None:
    size = contract.phi.block_size
    board.electronics.offset[contract.phi.order[size : 2 * size]] = 5
    board.reset()
    assert (board.electronics.offset[contract.phi.order[size : 2 * size]] == 5).all()


def test_folder_outlives_the_process(contract: Contract, tmp_path: Path) -> None:
    first = Board(contract, tmp_path)
    first.write(od.OFFSET, 3, 100, 2)
    first.write(od.HEARTBEAT_MS, 0, 400, 2)
    first.write(od.STORE, 1, SAVE, 4)
    assert [path.name for path in tmp_path.iterdir()] == ["bus0-1.json"]
    second = Board(contract, tmp_path)
    assert (second.read(od.OFFSET, 3), second.offset, second.read(od.HEARTBEAT_MS)) == (100, 100.0, 400)
    second.write(od.RESTORE, 1, LOAD, 4)
    assert not list(tmp_path.iterdir())
    assert Board(contract, tmp_path).offset == 0.0


def test_full_disk_is_an_abort_and_loses_nothing(
    contract: Contract, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    board = Board(contract, tmp_path)
    board.write(od.OFFSET, 3, 100, 2)
    board.write(od.STORE, 1, SAVE, 4)
    board.write(od.OFFSET, 3, 7, 2)
    monkeypatch.setattr(Path, "replace", lambda *_: (_ for _ in ()).throw(OSError(28, "No space left on device")))
    assert board.write(od.STORE, 1, SAVE, 4) == Abort.HARDWARE
    monkeypatch.undo()
    assert Board(contract, tmp_path).offset == 100.0


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


def test_what_does_not_fit_the_dictionary_is_not_restored(contract: Contract, tmp_path: Path) -> None:
    """A file that was written by hand can put nothing into a node that an SDO write could not."""
    parameters = {
        0x1000: {0: b"\1\0\0\0"},
        0x1017: {0: b"\1"},
        0x1029: {1: b"\x09"},
        0x1A00: {1: bytes.fromhex("10c80021")},
        0x1A01: {0: b"\5", 5: bytes.fromhex("10050021")},  # one sum more than a classic frame holds
        0x5000: {0: b"\1"},
        od.TEST_PATTERN: {0: b"\2"},
    }
    Storage(contract.phi.fingerprint, tmp_path / "bus0-1.json").save(parameters)
    board = Board(contract, tmp_path)
    assert (board.read(0x1000), board.read(od.HEARTBEAT_MS), board.sampler.pattern(0)) == (0, 1000, 0)
    assert board.read(0x1029, 1) == 0
    give(board.segment, board.link, frame(0, bytes((1, 1))))
    assert {can_id for can_id, _ in give(board.segment, board.link, sync(1))} == set()  # both are mapped wrongly


def test_a_folder_that_loses_its_file_in_vain_is_an_abort(
    contract: Contract, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    board = Board(contract, tmp_path)
    board.write(od.OFFSET, 3, 100, 2)
    board.write(od.STORE, 1, SAVE, 4)

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "unlink", refuse)
    assert board.write(od.RESTORE, 1, LOAD, 4) == Abort.HARDWARE
    board.reset()
    assert board.offset == 100.0


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


def test_a_reset_of_communication_brings_stored_communication_back_alone(board: Board) -> None:
    board.write(od.HEARTBEAT_MS, 0, 400, 2)
    board.write(od.OFFSET, 3, 100, 2)
    board.write(od.STORE, 1, SAVE, 4)
    board.write(od.HEARTBEAT_MS, 0, 700, 2)
    board.write(od.OFFSET, 3, 7, 2)
    board.reset(RESET_COMMUNICATION)
    assert (board.read(od.HEARTBEAT_MS), board.read(od.OFFSET, 3), board.offset) == (400, 7, 7.0)


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
