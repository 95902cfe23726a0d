"""Words of steps: every word means one thing, and says what it was made of."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dbc.steps import (
    BAD,
    CHECK,
    COUNT,
    HIGH,
    KEEP_MAX,
    SCALES,
    SEQUENCE,
    SET,
    SET_SUMS,
    SLOTS,
    STEP,
    Form,
    Integers,
    check_word,
    form_of,
    forms,
    hash_of,
    keep_max,
    kind_of,
    limits,
    move,
    put,
    read_word,
    set_word,
    slot_byte,
    slot_cycle,
    step_word,
    unit_n,
    write_word,
)

WORDS = 1 << 56
FORMS = [form_of(sums, has_first=has_first) for sums in range(1, 33) for has_first in (True, False)]
a_form, counts, slots = st.sampled_from(FORMS), st.integers(0, COUNT - 1), st.integers(0, SLOTS - 1)


def bounds(form: Form) -> Integers:
    return np.array([limits(place, form) for place in range(form.sums)], np.int64)


def integers(form: Form, data: st.DataObject) -> Integers:
    """Draw sums of a part."""
    return np.array([data.draw(st.integers(int(low), int(high))) for low, high in bounds(form)], np.int64)


@given(a_form, st.sampled_from(range(len(SCALES))), counts, st.data())
@settings(deadline=None)
def test_a_step_comes_back(form: Form, scale: int, count: int, data: st.DataObject) -> None:
    half = form.radix // 2
    digits = np.array(data.draw(st.lists(st.integers(-half, half), min_size=form.sums, max_size=form.sums)), np.int64)
    word = step_word(digits, scale, count, form)
    assert 0 <= word < form.steps
    kind, found, of_step, _, rest = kind_of(word, form)
    assert (kind, found, of_step) == (STEP, scale, count % SEQUENCE)
    known = integers(form, data)
    moved = known.copy()
    move(moved, scale, rest, form)
    assert np.array_equal(moved, known + digits * SCALES[scale])


@given(a_form, counts, slots, st.data())
@settings(deadline=None)
def test_a_set_comes_back(form: Form, count: int, slot: int, data: st.DataObject) -> None:
    wanted, known = integers(form, data), integers(form, data)
    group = data.draw(st.integers(0, form.groups - 1))
    word = set_word(group, wanted, count, slot, form)
    assert form.steps <= word < WORDS
    kind, found, of_set, high, rest = kind_of(word, form)
    assert (kind, found, of_set, 240 * high + slot_byte(slot) - 1) == (SET, group, count, slot)
    shown = known.copy()
    put(shown, group, rest, form)
    mine = slice(SET_SUMS * group, SET_SUMS * (group + 1))
    assert np.array_equal(shown[mine], wanted[mine])
    shown[mine] = known[mine]
    assert np.array_equal(shown, known)


@given(a_form, counts, slots, st.data())
@settings(deadline=None)
def test_a_check_comes_back(form: Form, count: int, slot: int, data: st.DataObject) -> None:
    known = integers(form, data)
    word = check_word(known, count, slot, form)
    assert form.steps <= word < WORDS
    assert kind_of(word, form) == (CHECK, 0, count, slot // 240, hash_of(known))


@given(a_form, st.integers(0, WORDS - 1))
@settings(deadline=None)
def test_a_word_means_one_thing_at_most(form: Form, word: int) -> None:
    kind, part, count, high, data = kind_of(word, form)
    if kind == STEP:
        total = part + len(SCALES) * count
        top = form.radix**form.sums
        assert (total * top + data, data < top, part < len(SCALES), count < SEQUENCE) == (word, True, True, True)
    elif kind != BAD:
        group = form.groups if kind == CHECK else part
        rest = group + (form.groups + 1) * (high + HIGH * (count + COUNT * data))
        assert form.steps + rest == word
        assert group <= form.groups
        assert data < (1 << 32 if kind == CHECK else 1 << 39)


@pytest.mark.parametrize("form", FORMS, ids=str)
def test_the_largest_words_have_56_bits(form: Form) -> None:
    most = bounds(form)[:, 1]
    assert step_word(np.full(form.sums, form.radix // 2), len(SCALES) - 1, SEQUENCE - 1, form) == form.steps - 1
    assert form.steps == len(SCALES) * SEQUENCE * form.radix**form.sums
    others = (form.groups + 1) * HIGH * COUNT << 39
    assert form.steps + others <= WORDS
    # Two more values of a digit would not fit.
    assert len(SCALES) * SEQUENCE * (form.radix + 2) ** form.sums + others > WORDS
    assert set_word(form.groups - 1, most, COUNT - 1, SLOTS - 1, form) < form.steps + others


@given(st.integers(0, WORDS - 1))
def test_bytes_of_a_word_come_back(word: int) -> None:
    payload = np.zeros(9, np.uint8)
    write_word(word, payload)
    assert int.from_bytes(payload.tobytes(), "little") == word
    assert read_word(payload[:7]) == word


def test_a_board_is_divided_into_parts_of_32_sums_or_of_8_on_can_fd() -> None:
    assert [[form.sums for form in forms(sums, is_fd=False)] for sums in (8, 16, 32, 64)] == [[8], [16], [32], [32, 32]]
    assert [[form.sums for form in forms(sums, is_fd=True)] for sums in (8, 16, 32, 64)] == [
        [8] * parts for parts in (1, 2, 4, 8)
    ]
    assert [form.has_first for form in forms(64, is_fd=False)] == [1, 0]
    assert [form.has_first for form in forms(32, is_fd=True)] == [1, 0, 0, 0]
    assert [form_of(sums).radix for sums in (8, 16, 32)] == [83, 9, 3]


def test_slots_come_again_after_a_multiple_of_those_of_240_syncs() -> None:
    for of_sync in range(1, 241):
        cycle = slot_cycle(of_sync)
        assert (240 * of_sync) % cycle == SLOTS % cycle == cycle % 240 == 0
    assert [slot_cycle(each) for each in (1, 2, HIGH, 5 * HIGH)] == [240, 240, SLOTS, SLOTS]
    assert [keep_max(each) for each in (1, HIGH)] == [120, KEEP_MAX]


def test_the_hash_is_fnv_1a_of_two_bytes_each() -> None:
    letters = np.frombuffer(b"foobar", "<i2").astype(np.int64)
    assert hash_of(letters) == 0xBF9CF968  # the authors' own test vector
    assert hash_of(np.array([-1, -4096])) == hash_of(np.array([0xFFFF, 0xF000]))


def test_the_unit_is_an_8192nd_of_the_sum_at_full_scale() -> None:
    assert unit_n(0.02, 32) == 0.64 / 8192
    assert (limits(0, form_of(32)), limits(1, form_of(32))) == ((0, 8191), (-4096, 4095))
    assert limits(0, form_of(32, has_first=False)) == (-4096, 4095)
