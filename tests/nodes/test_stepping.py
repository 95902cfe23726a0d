"""What a board sends in its slot: receivers hold the same integers, and see every loss."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dbc.steps import (
    CHECK,
    COUNT,
    FIRST_MAX,
    KEEP_MAX,
    KEEP_MIN,
    SCALES,
    SEQUENCE,
    SET,
    STEP,
    Form,
    Integers,
    form_of,
    forms,
    keep_max,
    kind_of,
    slot_byte,
    slot_cycle,
)
from nodes.steps.stepping import new_state, offer, threshold, whole
from tests.nodes.stepped_bus import Part

SLOTS = 25
#: An even threshold of a part, square units.
LEAST = 500.0


class Board:
    """A board of one frame, and a receiver."""

    def __init__(self, sums: int = 32, *, is_fd: bool = False, slots: int = SLOTS, least: float = LEAST) -> None:
        self.forms = forms(sums, is_fd=is_fd)[: 8 if is_fd else 1]
        self.rows = np.array(self.forms, np.int64)
        self.cycle, self.keep_max, self.least = slot_cycle(slots), keep_max(slots), least
        self.state = new_state(len(self.forms), 1, max(form.sums for form in self.forms))
        self.wanted = np.zeros_like(self.state.known)
        self.parts = [Part(form, self.cycle) for form in self.forms]
        self.slot = 0

    def pass_slot(self, *, arrives: bool = True) -> bool:
        """Let a slot pass; tell whether a frame was sent."""
        self.slot += 1
        slot = self.slot % self.cycle
        sent = offer(
            0, 0, len(self.forms), self.wanted, self.least, slot, self.cycle, self.keep_max, self.rows, self.state
        )
        if sent and arrives:
            for part, word in zip(self.parts, self.state.word.tolist(), strict=True):
                part.take(slot_byte(slot), word, slot)
        return bool(sent)

    def pass_slots(self, count: int) -> int:
        """Let slots pass; return how many frames were sent."""
        return sum(self.pass_slot() for _ in range(count))

    def ask(self) -> None:
        self.state.unset[0] = 0

    @property
    def is_same(self) -> bool:
        """Whether the receiver holds the board's integers."""
        return all(
            np.array_equal(part.known, self.state.known[place, : part.form.sums])
            for place, part in enumerate(self.parts)
        )

    def kinds(self) -> list[int]:
        """Return the kinds of the first part's words since the last call."""
        kinds, self.parts[0].kinds = self.parts[0].kinds, []
        return kinds


def started(**options: Any) -> Board:
    """Return a board that has set all sums."""
    made = Board(**options)
    assert made.pass_slots(made.forms[0].groups) == made.forms[0].groups
    assert set(made.kinds()) == {SET}
    return made


@st.composite
def scenes(draw: st.DrawFn) -> tuple[Board, list[tuple[int, Integers]]]:
    """Draw a board, and how its sums move: slots that pass, and the new sums."""
    board = Board(
        draw(st.sampled_from((8, 16, 32, 64))),
        is_fd=draw(st.booleans()),
        slots=draw(st.sampled_from((1, 3, SLOTS, 50))),
        least=draw(st.sampled_from((-1.0, 0.0, LEAST, 1e6))),
    )
    random = np.random.default_rng(draw(st.integers(0, 2**32)))
    moves = []
    for _ in range(draw(st.integers(1, 12))):
        size = 10 ** draw(st.floats(0, 4))
        moved = np.rint(random.normal(0, size, board.wanted.shape)).astype(np.int64)
        moves.append((draw(st.integers(1, 40)), np.clip(moved, -4096, 4095)))
    return board, moves


def follow(board: Board, sums: Integers) -> None:
    board.wanted[:] = sums
    board.wanted[0, 0] = abs(board.wanted[0, 0])


@given(scenes(), st.data())
@settings(deadline=None, max_examples=60)
def test_without_loss_a_receiver_holds_the_integers_of_the_board(
    scene: tuple[Board, list[tuple[int, Integers]]], data: st.DataObject
) -> None:
    board, moves = scene
    for slots, sums in moves:
        follow(board, sums)
        board.slot += data.draw(st.integers(0, 5))  # left out
        for _ in range(slots):
            board.pass_slot()
        assert board.is_same or board.parts[0].missing
    board.pass_slots(board.forms[0].groups)
    assert board.is_same
    assert all(part.is_whole and part.gaps == 1 and part.different == 0 for part in board.parts)  # 1: the first word


@given(st.integers(0, 2**32), st.integers(1, COUNT - 1), st.booleans(), st.sampled_from((-1.0, LEAST)))
@settings(deadline=None, max_examples=60)
def test_every_loss_of_less_than_count_words_is_seen_at_the_next_word(
    seed: int, lost: int, is_fd: bool, least: float
) -> None:
    board, random = started(is_fd=is_fd, least=least), np.random.default_rng(seed)

    def word(*, arrives: bool) -> None:
        follow(board, np.clip(board.wanted + np.rint(random.normal(0, 30, board.wanted.shape)), -4096, 4095))
        while not board.pass_slot(arrives=arrives):
            pass

    for _ in range(int(random.integers(1, 100))):
        word(arrives=True)
    assert all(part.is_whole for part in board.parts)
    for _ in range(lost):
        word(arrives=False)
    word(arrives=True)
    assert not any(part.is_whole for part in board.parts)
    board.ask()
    board.pass_slots(board.forms[0].groups)
    assert all(part.is_whole for part in board.parts)
    assert board.is_same


def test_small_changes_are_steps_and_a_large_one_of_few_sums_is_a_set() -> None:
    board = started()
    board.wanted[0] += 10
    board.pass_slots(3)
    assert set(board.kinds()) == {STEP}
    assert np.abs(board.wanted - board.state.known).max() <= 2
    board.wanted[0, [9, 11]] = 3000, -3000  # of group 3
    board.pass_slot()
    assert board.kinds() == [SET]
    assert board.state.known[0, [9, 11]].tolist() == [3000, -3000]


def test_of_words_that_are_worth_the_same_the_first_is_sent() -> None:
    board = started(least=-1.0)
    board.pass_slot()  # no scale is better than another
    assert kind_of(int(board.state.word[0]), board.forms[0])[:2] == (STEP, 0)
    board = started()
    board.slot += SEQUENCE  # no step
    board.wanted[0, [4, 7, 10]] = 1000
    board.pass_slot()
    assert kind_of(int(board.state.word[0]), board.forms[0])[:2] == (SET, 1)
    # A set of three sums, and a step, tell all.
    board = started(least=10.0)
    board.wanted[0, 4] = SCALES[1]
    board.pass_slot()
    assert kind_of(int(board.state.word[0]), board.forms[0])[:2] == (STEP, 1)


def test_on_can_fd_each_part_takes_its_best_word() -> None:
    board = started(is_fd=True)
    board.wanted[0, 5], board.wanted[2] = -2000, 70
    board.pass_slot()
    assert [part.kinds[-1] for part in board.parts] == [SET, STEP, STEP, STEP]
    assert board.is_same
    assert np.abs(board.wanted - board.state.known).max() <= 4


def test_a_slot_stays_empty_unless_the_frame_takes_more_than_the_threshold() -> None:
    # A step of the least scale takes 2 d² or so from one sum.
    board = started(least=100.0)
    board.wanted[0, 4] = 10
    assert not board.pass_slot()
    board.wanted[0, 4] = 11
    assert board.pass_slot()
    silent = started(least=-1.0)
    assert silent.pass_slots(50) == 50  # 2031h:1 is 0: in every slot


def test_a_silent_board_checks_ever_more_rarely() -> None:
    board = started()
    at = [board.slot for _ in range(2000) if board.pass_slot()]
    assert set(board.kinds()) == {CHECK}
    assert np.diff([11, *at]).tolist() == [
        *(KEEP_MIN << each for each in range(5)),
        *[KEEP_MAX] * 2,
    ]
    board.wanted[0] += 20
    board.pass_slots(4)
    moved = board.slot
    board.kinds()
    while not board.pass_slot():
        pass
    assert board.kinds() == [CHECK]
    assert board.slot - moved <= KEEP_MIN
    assert keep_max(1) < KEEP_MAX


def test_a_board_that_sends_in_every_slot_checks_after_64_words() -> None:
    board, random = Board(least=-1.0), np.random.default_rng(1)
    for _ in range(300):
        follow(board, np.clip(board.wanted + np.rint(random.normal(0, 20, board.wanted.shape)), -4096, 4095))
        board.pass_slot()
    checks = np.flatnonzero(np.array(board.kinds()) == CHECK)
    assert np.diff([-1, *checks]).tolist() == [65] * 4


def test_after_more_than_three_slots_a_board_sends_no_step() -> None:
    for empty, kind in ((2, STEP), (3, SET)):
        board = started()
        assert board.pass_slots(empty) == 0
        board.wanted[0] += 20
        board.pass_slot()
        assert board.kinds() == [kind]


@pytest.mark.parametrize(
    ("form", "sums_n", "expected"),
    [
        (form_of(4), [1.5, 2.5, -1.5, -0.4], [2, 2, -2, 0]),  # halves to even
        (form_of(4), [-3, -5000, 5000, 9], [0, -4096, 4095, 9]),
        (form_of(4), [9000, 0, 0, 0], [FIRST_MAX, 0, 0, 0]),
        (form_of(2, has_first=False), [-3, 9000], [-3, 4095]),
    ],
)
def test_sums_are_whole_units_within_their_bounds(form: Form, sums_n: list[float], expected: list[int]) -> None:
    found = np.zeros(form.sums, np.int64)
    whole(np.array(sums_n, np.float32) * np.float32(0.25), 0.25, form, found)
    assert found.tolist() == expected


def test_the_threshold_is_that_of_the_document() -> None:
    form, variance = form_of(32), np.full(32, 2e-9, np.float32)
    least = threshold(variance, 2e-4, 32, 0.64 / 8192, 0.1, form)
    assert least == pytest.approx(0.1 * ((32 * 32 * (0.15 * 2e-4) ** 2 + 2 * 32 * 2e-9) / (0.64 / 8192) ** 2 + 32))
    assert threshold(variance, 2e-4, 32, 0.64 / 8192, 0.0, form) < 0
