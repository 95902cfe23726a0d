"""How boards send steps: board and receiver hold the same integers, and each frame moves all of them, or sets three.

The sums of a board in units of `unit_n` are integers; 32 of them, or 8 on CAN FD, are a *part*, and a part travels as
one *word* of 56 bits. A word is of one of three kinds:

- a *step* moves each integer by a digit times the scale of the word,
- a *set* gives three integers as they are,
- a *check* has a hash of all integers, and moves nothing.

**Losses.** Words of a part are counted. A step has the count modulo `SEQUENCE`, which tells of every loss of fewer
words. A board has one slot for each word. So it sends a step only within `SEQUENCE` slots of its newest word, and later
a set or a check, which have the count modulo `COUNT`.

**Slots.** The first byte of a frame is 2022h: 1 + the number of its slot modulo 240. Slots are counted on from SYNC to
SYNC. Sets and checks have the number modulo `SLOTS`, so a frame that was held back for long is told from a new one.
"""

import math
from functools import cache
from typing import Final, NamedTuple

import numpy as np

from dbc.frame_fields import Bytes, Integers
from shell.compiled import njit
from skin.sync_counter import SYNC_OVERFLOW
from skin.ways_of_sending import SUM_BITS

#: Bytes of a word, and what a word is less than.
WORD_BYTES: Final = 7
_WORDS: Final = 1 << 8 * WORD_BYTES
#: Most sums of a part on a classic bus and on CAN FD, where a frame has room for more digits.
PART_SUMS: Final = 32
FD_PART_SUMS: Final = 8
#: Units of a digit, by the scale of a step.
SCALES: Final = (3, 6, 12, 24, 48, 96, 192, 384)
#: The count of a step is modulo this number.
SEQUENCE: Final = 3
#: The count of a set or a check is modulo this number, a multiple of `SEQUENCE`.
COUNT: Final = 720
#: How many times `SYNC_OVERFLOW` slots are told apart.
HIGH: Final = 5
SLOTS: Final = HIGH * SYNC_OVERFLOW
#: Sums of a set, the bits of each, and its values: of the first sum, which is never negative, and of all others.
SET_SUMS: Final = 3
SET_BITS: Final = SUM_BITS
FIRST_MAX: Final = (1 << SET_BITS) - 1
OTHER_MIN: Final = -(1 << SET_BITS - 1)
OTHER_MAX: Final = -OTHER_MIN - 1
#: Units of the sum of all taxels at full scale.
FULL_SCALE: Final = FIRST_MAX + 1
#: A silent board sends a check after `KEEP_MIN` slots, and then after twice the time of the check before, up to
#: `KEEP_MAX` slots. While the board sends, every word after `CHECK_EVERY` others is a check.
KEEP_MIN: Final = 24
KEEP_MAX: Final = 480
CHECK_EVERY: Final = 64
#: A word is worth its bits if it takes more than this from the squared difference of a part's sums, square units:
#: 2031h:1 times (sums · taxels · (`NOISE_RATIO` · noise of the board)² + `VARIANCE_RATIO` · variance of these sums, and
#: a square unit for each sum, without which boards that have no noise would send whatever they round).
NOISE_RATIO: Final = 0.15
VARIANCE_RATIO: Final = 2.0
#: A word that is this number of slots old is in time; in an older word's part the sums are held.
LATE_SLOTS: Final = 4
#: Kinds of words; `BAD` are numbers that no board sends.
STEP, SET, CHECK, BAD = range(4)
FNV_BASIS: Final = 2_166_136_261
FNV_PRIME: Final = 16_777_619
_32_BITS: Final = (1 << 32) - 1


class Form(NamedTuple):
    """The words of a part.

    Attributes
    ----------
    sums : int
    radix : int
        Values of a digit, an odd number: from -(radix // 2) to radix // 2.
    steps : int
        Number of words that are steps, `len(SCALES)` · `SEQUENCE` · radix^sums; all further ones are sets and checks.
    groups : int
        Sets of the part: sums 3 g to 3 g + 2 are those of group g.
    has_first : int
        1 if the first sum is that of all taxels, else 0.
    """

    sums: int
    radix: int
    steps: int
    groups: int
    has_first: int


@cache
def form_of(sums: int, *, has_first: bool = True) -> Form:
    """Return the form of a part: as many values of a digit as 56 bits hold beside sets and checks."""
    groups = -(-sums // SET_SUMS)
    others = (groups + 1) * COUNT * HIGH << SET_SUMS * SET_BITS
    kinds = len(SCALES) * SEQUENCE
    radix = int(((_WORDS - others) / kinds) ** (1 / sums))
    radix -= radix % 2 == 0
    return Form(sums, radix, kinds * radix**sums, groups, int(has_first))


def forms(sums: int, *, is_fd: bool) -> list[Form]:
    """Return the forms of all parts of a board with `sums` sums, in order."""
    size = min(sums, FD_PART_SUMS if is_fd else PART_SUMS)
    return [form_of(min(size, sums - first), has_first=first == 0) for first in range(0, sums, size)]


def unit_n(force_max_n: float, taxels: int) -> float:
    """Return the unit of a board of `taxels` taxels whose full scale is `force_max_n`, newtons."""
    return taxels * force_max_n / FULL_SCALE


def slot_cycle(slots: int) -> int:
    """Return after how many slots their numbers come again, if a SYNC comes every `slots` slots.

    SYNC counters come again after `SYNC_OVERFLOW`, so numbers above that of the first byte need enough slots.
    """
    return math.gcd(SLOTS, SYNC_OVERFLOW * slots)


def keep_max(slots: int) -> int:
    """Return after how many slots a silent board sends a check at the latest: its number is then no older than half."""
    return min(KEEP_MAX, slot_cycle(slots) // 2)


@njit(cache=True, nogil=True)
def form_at(forms: Integers, part: int) -> Form:
    """Return the form of a part from its row, as `dbc.contract.PartTable` holds the forms."""
    row = forms[part]
    return Form(row[0], row[1], row[2], row[3], row[4])


@njit(cache=True, nogil=True)
def limits(place: int, form: Form) -> tuple[int, int]:
    """Return the least and the most value of a sum of a part."""
    if place == 0 and form.has_first:
        return 0, FIRST_MAX
    return OTHER_MIN, OTHER_MAX


@njit(cache=True, nogil=True)
def step_word(digits: Integers, scale: int, count: int, form: Form) -> int:
    """Return the word of a step: digit · radix^place, digits from 0 on, then scale, then count."""
    total = scale + len(SCALES) * (count % SEQUENCE)
    for place in range(form.sums - 1, -1, -1):
        total = total * form.radix + digits[place] + form.radix // 2
    return int(total)


@njit(cache=True, nogil=True)
def set_word(group: int, known: Integers, count: int, slot: int, form: Form) -> int:
    """Return the word that sets a group to the integers of `known`."""
    data = 0
    for place in range(min(SET_SUMS, form.sums - SET_SUMS * group)):
        least, _ = limits(SET_SUMS * group + place, form)
        data |= (known[SET_SUMS * group + place] - least) << SET_BITS * place
    return _other_word(group, data, count, slot, form)


@njit(cache=True, nogil=True)
def check_word(known: Integers, count: int, slot: int, form: Form) -> int:
    """Return the word that has the hash of `known`."""
    return _other_word(form.groups, hash_of(known), count, slot, form)


@njit(cache=True, nogil=True)
def _other_word(group: int, data: int, count: int, slot: int, form: Form) -> int:
    high = slot % SLOTS // SYNC_OVERFLOW
    return int(form.steps + group + (form.groups + 1) * (high + HIGH * (count + COUNT * data)))


@njit(cache=True, nogil=True)
def kind_of(word: int, form: Form) -> tuple[int, int, int, int, int]:
    """Return kind, scale or group, count, slots above the first byte in `SYNC_OVERFLOW`s, and data of a word."""
    if word < form.steps:
        values = form.steps // (len(SCALES) * SEQUENCE)  # of all digits together
        head, data = word // values, word % values
        return STEP, head % len(SCALES), head // len(SCALES), 0, data
    rest = word - form.steps
    group, rest = rest % (form.groups + 1), rest // (form.groups + 1)
    high, rest = rest % HIGH, rest // HIGH
    count, data = rest % COUNT, rest // COUNT
    if group == form.groups:
        return CHECK if data <= _32_BITS else BAD, 0, count, high, data
    return SET if data < 1 << SET_SUMS * SET_BITS else BAD, group, count, high, data


@njit(cache=True, nogil=True)
def move(known: Integers, scale: int, data: int, form: Form) -> None:
    """Move all integers by the digits of a step."""
    for place in range(form.sums):
        known[place] += (data % form.radix - form.radix // 2) * SCALES[scale]
        data //= form.radix


@njit(cache=True, nogil=True)
def put(known: Integers, group: int, data: int, form: Form) -> None:
    """Set the integers of a group."""
    for place in range(min(SET_SUMS, form.sums - SET_SUMS * group)):
        least, _ = limits(SET_SUMS * group + place, form)
        known[SET_SUMS * group + place] = (data >> SET_BITS * place & FIRST_MAX) + least


@njit(cache=True, nogil=True)
def hash_of(known: Integers) -> int:
    """Return the FNV-1a hash (32 bits) of the integers, each as two bytes, little endian, two's complement."""
    total = FNV_BASIS
    for value in known:
        for shift in (0, 8):
            total = (total ^ (value >> shift & 0xFF)) * FNV_PRIME & _32_BITS
    return int(total)


@njit(cache=True, nogil=True)
def write_word(word: int, payload: Bytes) -> None:
    """Write a word as `WORD_BYTES` bytes, little endian."""
    for place in range(WORD_BYTES):
        payload[place] = word >> 8 * place & 0xFF


@njit(cache=True, nogil=True)
def read_word(payload: Bytes) -> int:
    """Return the word of `WORD_BYTES` bytes."""
    word = 0
    for place in range(WORD_BYTES):
        word |= int(payload[place]) << 8 * place
    return word


@njit(cache=True, nogil=True)
def slot_byte(slot: int) -> int:
    """Return 2022h of a slot."""
    return int(slot % SYNC_OVERFLOW + 1)


def slots_since(byte: Integers, newest: Integers) -> Integers:
    """Return how many slots before the slot number `newest` that with 2022h `byte` began: 0 to `SYNC_OVERFLOW` - 1."""
    since: Integers = (newest - (byte.astype(np.int64) - 1)) % SYNC_OVERFLOW
    return since
