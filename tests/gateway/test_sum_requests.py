"""Requests to stepped nodes: all sums again at growing pauses, few nodes at a time, and their noise in turn."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from canskin.messages import BlockState
from dbc.canopen import SDO_RESPONSE_BASE
from gateway.nmt_master import NmtMaster
from gateway.sdo import Dialogue, Read, SdoDialogue, Transfer, Write
from gateway.sum_requests import SumRequests
from tests.gateway.boards import BoardWorld, at_rest, states

AGAIN = 0x2030
NOISE = 0x2035
#: Time in which a node tells all its sums, and from SYNC to SYNC.
TELLING_S, SYNC_S = 0.0625, 0.125


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
    """`SumRequests`; nodes have nothing to tell until the test says so."""

    def __init__(self) -> None:
        self.master = Asking()
        self.noise: list[tuple[int, float]] = []
        self.sum_requests = SumRequests(
            cast("NmtMaster", self.master),
            lambda node, noise_n: self.noise.append((node, noise_n)),
            TELLING_S,
            SYNC_S,
        )
        self.is_wanted = np.zeros(6, np.bool_)

    def tick(self, now_s: float, *, answered: bool = True, index: int = AGAIN) -> list[tuple[int, Transfer]]:
        """Return what was asked for an object."""
        self.sum_requests.tick(now_s, self.is_wanted)
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


def _nothing(_skin: Skin) -> None:
    """Nothing happens."""


def again(node_id: int) -> tuple[int, Write]:
    return node_id, Write(AGAIN, 0, b"\1")


@pytest.fixture
def skin() -> Skin:
    return Skin()


def test_nothing_is_asked_of_a_node_that_is_not_proven(skin: Skin) -> None:
    skin.is_wanted[:] = True
    assert skin.tick(0.0) == []
    skin.proven(2)
    assert [node_id for node_id, _ in skin.tick(1.0)] == [13]
    skin.sum_requests.lost(2)
    assert skin.tick(100.0) == []


def test_a_node_that_starts_sends_all_sums_by_itself(skin: Skin) -> None:
    """It waits for a SYNC first."""
    skin.proven(0, started_s=0.0)
    skin.proven(1)  # it has been running
    skin.is_wanted[:2] = True
    assert skin.tick(0.0) == [again(12)]
    skin.is_wanted[1] = False
    assert skin.tick(0.15) == []
    assert skin.tick(0.18) == []
    assert skin.tick(0.1925) == [again(11)]


def test_pauses_grow_up_to_eight_times_the_time_of_all_sums(skin: Skin) -> None:
    skin.proven(0)
    skin.is_wanted[0] = True
    asked_s = [now_ms / 1000 for now_ms in range(0, 3_000, 20) if skin.tick(now_ms / 1000)]
    assert np.diff(asked_s).tolist() == pytest.approx([0.0625, 0.125, 0.25, *[0.5] * 5], abs=0.021)


#: By time: nodes from which sums are missing, what else happens first, and node-IDs that are asked.
COURSES: dict[str, list[tuple[float, str, Callable[[Skin], object], list[int]]]] = {
    "a node that needs nothing more begins with the shortest pause": [
        *((now_s, "0", _nothing, [11]) for now_s in (0.0, 0.0625, 0.1875)),  # the next pause ends at 0.4375
        *((0.3, "", _nothing, []), (0.4, "0", _nothing, []), (0.4375, "0", _nothing, [11]), (1.0, "", _nothing, [])),
        *((1.125, "0", _nothing, [11]), (1.1875, "0", _nothing, [11])),
    ],
    "a proof and the return of the bus begin the pauses anew": [
        *((now_s, "01", _nothing, [11, 12]) for now_s in (0.0, 0.0625, 0.1875)),
        *((0.25, "01", lambda skin: skin.proven(0, now_s=0.2), [11]), (0.3125, "01", _nothing, [11])),
        *((0.34375, "01", lambda skin: skin.sum_requests.again(), [11, 12]), (0.375, "01", _nothing, [])),
        (0.40625, "01", _nothing, [11, 12]),
    ],
    "a quiet bus is asked for nothing and has time to start": [
        *((0.0, "0", lambda skin: setattr(skin.master, "is_quiet", True), []), (0.25, "0", _nothing, [])),
        (0.3125, "0", lambda skin: setattr(skin.master, "is_quiet", False), []),
        *((0.42, "0", _nothing, []), (0.4375, "0", _nothing, [11])),
    ],
    "a busy node is asked as soon as it is free": [
        *((0.0, "0", lambda skin: skin.master.busy.add(11), []), (0.0156, "0", _nothing, [])),
        (0.03125, "0", lambda skin: skin.master.busy.clear(), [11]),
        (0.125, "0", _nothing, [11]),  # after the first pause
    ],
}


@pytest.mark.parametrize("course", COURSES)
def test_course_of_the_requests(skin: Skin, course: str) -> None:
    skin.proven(0, 1)
    for now_s, wanted, happens, asked in COURSES[course]:
        happens(skin)
        skin.is_wanted[:] = [str(node) in wanted for node in range(6)]
        assert skin.tick(now_s) == [again(node_id) for node_id in asked], now_s


def test_four_nodes_are_asked_at_a_time_and_who_has_waited_longest_is_next(skin: Skin) -> None:
    skin.proven(*range(6))
    skin.is_wanted[:4] = True
    assert [node_id for node_id, _ in skin.tick(0.0, answered=False)] == [11, 12, 13, 14]
    skin.is_wanted[4] = True
    assert skin.tick(0.03125, answered=False) == []
    skin.is_wanted[:3] = False
    skin.master.answer(13)
    assert [node_id for node_id, _ in skin.tick(0.0625, answered=False)] == [15]
    assert not skin.master.restarts_s


def test_where_sums_of_many_nodes_are_missing_all_start_again_at_growing_pauses(skin: Skin) -> None:
    skin.proven(*range(6))
    skin.is_wanted[:5] = True
    for now_ms in range(0, 3_000, 20):
        assert skin.tick(now_ms / 1000) == []
    pauses_s = np.diff(skin.master.restarts_s).tolist()
    assert pauses_s == pytest.approx([0.0625, 0.125, 0.25, *[0.5] * 5], abs=0.021)


# Noise


def noise(node_id: int) -> tuple[int, Read]:
    return node_id, Read(NOISE, 0, 0x08)


def test_noise_is_read_after_the_proof_and_every_ten_seconds_one_node_in_a_tick(skin: Skin) -> None:
    skin.sum_requests.proven(1, 0.0)
    skin.sum_requests.proven(4, 0.0)
    assert [skin.noise_asked(now_s) for now_s in (0.0, 0.02, 0.04)] == [[noise(12)], [noise(15)], []]
    assert skin.noise_asked(9.99) == []
    assert [skin.noise_asked(now_s) for now_s in (10.0, 10.02, 10.04)] == [[noise(12)], [noise(15)], []]


def test_noise_of_a_busy_node_is_tried_again_after_a_second_and_of_a_lost_node_not(skin: Skin) -> None:
    skin.sum_requests.proven(1, 0.0)
    skin.master.busy = {12}
    assert skin.noise_asked(0.0) == []
    skin.master.busy.clear()
    assert [skin.noise_asked(now_s) for now_s in (0.99, 1.0)] == [[], [noise(12)]]
    skin.sum_requests.lost(1)
    assert skin.noise_asked(50.0) == []


@pytest.mark.parametrize(
    ("data", "noise_n"),
    [
        ("0000003f", [0.5]),
        ("00000000", []),
        ("000000bf", []),
        ("0000807f", []),
        ("0000c07f", []),
    ],
    ids=["a half", "none", "negative", "infinite", "no number"],
)
def test_noise_is_a_number_above_zero(skin: Skin, data: str, noise_n: list[float]) -> None:
    skin.sum_requests.proven(3, 0.0)
    skin.tick(0.0, answered=False)
    skin.master.answer(14, bytes.fromhex(data))
    assert skin.noise == [(3, each) for each in noise_n]


# In the company of boards


def test_lost_answers_do_not_block_the_proof(boards: BoardWorld) -> None:
    at_rest(boards)
    wire, refresh = boards.wires[0], AGAIN.to_bytes(2, "little")
    wire.loses = lambda end, each: bool(
        end is wire.gateway and each["can_id"] == SDO_RESPONSE_BASE + 2 and each["data"][1:3].tobytes() == refresh
    )
    boards.boards[1].speaks = False
    boards.run(8.0)
    assert boards.gateway.masters[0].nodes[2].in_use
    assert states(boards.measured[-1])[1] == BlockState.DEAD
    assert not boards.lines
