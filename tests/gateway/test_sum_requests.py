"""Requests to adaptive nodes: groups again at growing pauses, few nodes at a time, and their noise in turn."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from canskin.messages import BlockState
from dbc.canopen import SDO_RESPONSE_BASE
from gateway.nmt_master import NmtMaster
from gateway.sdo import Dialogue, Read, SdoDialogue, Transfer, Write
from gateway.sum_requests import SumRequests
from tests.gateway.boards import BoardWorld, at_rest, lose, states

GROUPS = 0x2030
NOISE = 0x2035


class Asking:
    """A master of six nodes: what it was asked, and the dialogues that are open."""

    def __init__(self) -> None:
        self.node_ids = [11, 12, 13, 14, 15, 16]
        self.nodes = {node_id: SimpleNamespace(errand=None, commanded_s=-np.inf) for node_id in self.node_ids}
        self.is_quiet = False
        self.restarts_s: list[float] = []
        self.busy: set[int] = set()
        self.asked: list[tuple[int, Transfer]] = []

    def ask(self, node_id: int, steps: Dialogue, _now_s: float) -> SdoDialogue | None:
        if node_id in self.busy:
            return None
        self.asked.append((node_id, next(steps)))
        dialogue = cast("SdoDialogue", SimpleNamespace(steps=steps))
        self.nodes[node_id].errand = dialogue
        return dialogue

    def restart(self, now_s: float) -> None:
        self.restarts_s.append(now_s)

    def answer(self, node_id: int, data: bytes = b"") -> None:
        """Let a node answer, which ends its dialogue."""
        open_dialogue: Any = self.nodes[node_id].errand
        self.nodes[node_id].errand = None
        with pytest.raises(StopIteration):
            open_dialogue.steps.send(data)

    def taken(self) -> list[tuple[int, Transfer]]:
        asked, self.asked = self.asked, []
        return asked


class Skin:
    """`SumRequests`, with no groups missing until the test says so."""

    def __init__(self) -> None:
        self.master = Asking()
        self.noise: list[tuple[int, float]] = []
        self.sum_requests = SumRequests(
            cast("NmtMaster", self.master), lambda node, noise_n: self.noise.append((node, noise_n))
        )
        self.unknown, self.doubtful = np.zeros(6, np.uint8), np.zeros(6, np.uint8)

    def tick(self, now_s: float, *, answered: bool = True, index: int = GROUPS) -> list[tuple[int, Transfer]]:
        """Return what was asked for an object."""
        self.sum_requests.tick(now_s, self.unknown, self.doubtful)
        if answered:
            for node in self.master.nodes.values():
                node.errand = None
        return [each for each in self.master.taken() if each[1].index == index]

    def noise_asked(self, now_s: float) -> list[tuple[int, Transfer]]:
        return self.tick(now_s, index=NOISE)

    def proven(self, *nodes: int, now_s: float = 0.0, started_s: float = -np.inf) -> None:
        for node in nodes:
            self.master.nodes[self.master.node_ids[node]].commanded_s = started_s
            self.sum_requests.proven(node, now_s)


def groups(node_id: int, bits: int) -> tuple[int, Write]:
    return node_id, Write(GROUPS, 0, bytes((bits,)))


@pytest.fixture
def skin() -> Skin:
    return Skin()


def test_nothing_is_asked_of_a_node_that_is_not_proven(skin: Skin) -> None:
    skin.unknown[:], skin.doubtful[:] = 15, 15
    assert skin.tick(0.0) == []
    skin.proven(2)
    assert [node_id for node_id, _ in skin.tick(1.0)] == [13]
    skin.sum_requests.lost(2)
    assert skin.tick(100.0) == []


def test_a_node_that_starts_sends_all_groups_by_itself(skin: Skin) -> None:
    """0.6 s are for that, also on a full bus."""
    skin.proven(0, started_s=0.0)
    skin.proven(1)  # it has been running
    skin.unknown[0], skin.unknown[1], skin.doubtful[1] = 0b1001, 0b0001, 0b0100
    assert skin.tick(0.0) == [groups(12, 0b0101)]
    skin.unknown[1] = skin.doubtful[1] = 0
    assert skin.tick(0.55) == []
    assert skin.tick(0.599) == []
    assert skin.tick(0.6125) == [groups(11, 0b1001)]


def test_both_kinds_of_groups_are_asked_for_together(skin: Skin) -> None:
    skin.proven(5)
    skin.unknown[5], skin.doubtful[5] = 0b0011, 0b0110
    assert skin.tick(1.0) == [groups(16, 0b0111)]


def test_pauses_grow_up_to_two_seconds(skin: Skin) -> None:
    skin.proven(0)
    skin.doubtful[0] = 1
    asked_s = [now_ms / 1000 for now_ms in range(0, 10_000, 20) if skin.tick(now_ms / 1000)]
    assert np.diff(asked_s).tolist() == pytest.approx([0.1, 0.2, 0.4, 0.8, 1.6, 2.0, 2.0, 2.0], abs=0.021)


def test_pauses_begin_anew_two_seconds_after_the_last_would_have_ended(skin: Skin) -> None:
    skin.proven(0)
    skin.doubtful[0] = 1
    for now_s in (0.0, 0.125, 0.375):  # the next pause ends at 0.775
        assert skin.tick(now_s) == [groups(11, 1)]
    skin.doubtful[0] = 0
    assert skin.tick(2.7) == []
    skin.doubtful[0] = 1
    assert skin.tick(2.75) == [groups(11, 1)]
    assert skin.tick(3.25) == []  # the pause is 0.8 s
    assert skin.tick(3.75) == [groups(11, 1)]
    skin.doubtful[0] = 0
    skin.tick(8.0)  # 1.6 s and 2 s later
    skin.doubtful[0] = 1
    assert skin.tick(8.5) == [groups(11, 1)]
    assert skin.tick(8.625) == [groups(11, 1)]


def test_a_proof_and_the_return_of_the_bus_begin_the_pauses_anew(skin: Skin) -> None:
    skin.proven(0, 1)
    skin.doubtful[:2] = 1
    for now_s in (0.0, 0.125, 0.375):
        skin.tick(now_s)
    skin.proven(0, now_s=0.4)
    assert skin.tick(0.4375) == [groups(11, 1)]
    assert skin.tick(0.5625) == [groups(11, 1)]
    skin.sum_requests.again()
    assert skin.tick(0.59375) == [groups(11, 1), groups(12, 1)]
    assert skin.tick(0.6) == []
    assert skin.tick(0.71875) == [groups(11, 1), groups(12, 1)]


def test_four_nodes_are_asked_at_a_time_and_who_has_waited_longest_is_next(skin: Skin) -> None:
    skin.proven(*range(6))
    skin.doubtful[:4] = 1
    assert [node_id for node_id, _ in skin.tick(0.0, answered=False)] == [11, 12, 13, 14]
    skin.doubtful[4] = 1
    assert skin.tick(0.0625, answered=False) == []
    skin.doubtful[:3] = 0
    skin.master.answer(13)
    assert [node_id for node_id, _ in skin.tick(0.125, answered=False)] == [15]
    assert not skin.master.restarts_s


def test_where_groups_of_many_nodes_are_missing_all_start_again_at_growing_pauses(skin: Skin) -> None:
    skin.proven(*range(6))
    skin.doubtful[:5] = 1
    for now_ms in range(0, 10_000, 20):
        assert skin.tick(now_ms / 1000) == []
    pauses_s = np.diff(skin.master.restarts_s).tolist()
    assert pauses_s == pytest.approx([0.1, 0.2, 0.4, 0.8, 1.6, 2.0, 2.0, 2.0], abs=0.021)


def test_a_quiet_bus_is_asked_for_nothing_and_has_time_to_start(skin: Skin) -> None:
    skin.proven(0)
    skin.doubtful[0], skin.master.is_quiet = 1, True
    assert [skin.tick(now_s) for now_s in (0.0, 0.25)] == [[], []]
    skin.master.is_quiet = False
    assert [skin.tick(now_s) for now_s in (0.3125, 0.84, 0.875)] == [[], [], [groups(11, 1)]]


def test_a_busy_node_is_asked_as_soon_as_it_is_free(skin: Skin) -> None:
    skin.proven(0)
    skin.doubtful[0] = 1
    skin.master.busy = {11}
    assert skin.tick(0.0) == skin.tick(0.0156) == []
    skin.master.busy.clear()
    assert skin.tick(0.03125) == [groups(11, 1)]
    assert skin.tick(0.14) == [groups(11, 1)]  # after the first pause


def test_ticks_within_ten_milliseconds_are_one(skin: Skin) -> None:
    skin.proven(0)
    assert skin.tick(0.0) == []
    skin.doubtful[0] = 1
    assert skin.tick(0.0099) == []
    assert skin.tick(0.0101) == [groups(11, 1)]


# Noise


def noise(node_id: int) -> tuple[int, Read]:
    return node_id, Read(NOISE)


def test_noise_is_read_after_the_proof_and_every_ten_seconds_one_node_in_a_tick(skin: Skin) -> None:
    skin.sum_requests.proven(1, 0.0)
    skin.sum_requests.proven(4, 0.0)
    assert [skin.noise_asked(now_s) for now_s in (0.0, 0.02, 0.04)] == [[noise(12)], [noise(15)], []]
    assert skin.noise_asked(9.99) == []
    assert [skin.noise_asked(now_s) for now_s in (10.0, 10.02, 10.04)] == [[noise(12)], [noise(15)], []]


def test_noise_of_a_busy_node_is_tried_again_after_a_second(skin: Skin) -> None:
    skin.sum_requests.proven(1, 0.0)
    skin.master.busy = {12}
    assert skin.noise_asked(0.0) == []
    skin.master.busy.clear()
    assert skin.noise_asked(0.99) == []
    assert skin.noise_asked(1.0) == [noise(12)]


@pytest.mark.parametrize(
    ("data", "noise_n"),
    [
        ("0000003f", [0.5]),
        ("00000000", []),
        ("000000bf", []),
        ("0000807f", []),
        ("0000c07f", []),
        ("00003f", []),
        ("0000003f00", []),
        ("", []),
    ],
    ids=["a half", "none", "negative", "infinite", "no number", "three bytes", "five bytes", "nothing"],
)
def test_noise_is_a_number_above_zero(skin: Skin, data: str, noise_n: list[float]) -> None:
    skin.sum_requests.proven(3, 0.0)
    skin.tick(0.0, answered=False)
    skin.master.answer(14, bytes.fromhex(data))
    assert skin.noise == [(3, each) for each in noise_n]


def test_a_node_that_is_lost_is_not_asked_for_its_noise(skin: Skin) -> None:
    skin.sum_requests.proven(3, 0.0)
    skin.sum_requests.lost(3)
    assert skin.noise_asked(50.0) == []


# In the company of boards


def test_lost_answers_do_not_block_the_proof(boards: BoardWorld) -> None:
    at_rest(boards)
    wire, refresh = boards.wires[0], GROUPS.to_bytes(2, "little")
    wire.loses = lambda end, each: bool(
        end is wire.gateway and each["can_id"] == SDO_RESPONSE_BASE + 2 and each["data"][1:3].tobytes() == refresh
    )
    boards.boards[1].speaks = False
    lose(boards, 0)
    boards.run(8.0)
    assert boards.gateway.masters[0].nodes[2].in_use
    assert states(boards.measured[-1])[1] == BlockState.STALE
    assert not boards.lines
