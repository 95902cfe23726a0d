"""Codes of adaptive sums, and identifiers that carry urgency."""

from itertools import combinations, product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dbc.adaptive import (
    FINE_LEVELS,
    FINE_LIMIT,
    FINE_REACH,
    FIRST_COB_ID,
    GROUP_SUMS,
    KINDS,
    LEVELS,
    MEAN_CODES,
    OTHER_CODES,
    PAUSE_MS,
    SAVED_FRAMES,
    SAVING_S,
    Companding,
    SendingRule,
    carried,
    check_of,
    coarse_code,
    coarse_step,
    coarse_value,
    cob_id,
    companding,
    fine_steps,
    frame_of,
    has_same_code,
    pack_fine,
    unpack_fine,
)
from skin.sending import IDENTIFIERS
from tests.layouts import BLOCK_SUMS

LAW = companding(0.02, 0.5e-3, BLOCK_SUMS)
TOP_N = 32 * 0.02


@pytest.mark.parametrize("is_mean", [True, False])
def test_every_coarse_code_comes_back(is_mean: bool) -> None:
    codes = range(MEAN_CODES + 1) if is_mean else range(1, 2 * OTHER_CODES + 2)
    values = [coarse_value(code, is_mean, LAW) for code in codes]
    assert [coarse_code(value, is_mean, LAW) for value in values] == list(codes)
    assert np.all(np.diff(values) > 0)
    assert coarse_value(0 if is_mean else 128, is_mean, LAW) == 0


@given(st.floats(0, 1), st.booleans())
@settings(deadline=None)
def test_a_sum_is_off_by_half_a_step_of_its_place(part: float, is_mean: bool) -> None:
    value = part * TOP_N if is_mean else (part - 0.5) * TOP_N
    shown = coarse_value(coarse_code(value, is_mean, LAW), is_mean, LAW)
    assert abs(shown - value) <= 0.52 * coarse_step(max(abs(value), abs(shown)), is_mean, LAW)


def test_steps_are_as_asked_near_0_and_no_sum_leaves_the_range() -> None:
    assert coarse_value(1, True, LAW) == pytest.approx(0.5e-3, rel=1e-3)
    assert coarse_value(129, False, LAW) == pytest.approx(0.5e-3, rel=1e-3)
    assert coarse_value(MEAN_CODES, True, LAW) > TOP_N
    assert coarse_value(2 * OTHER_CODES + 1, False, LAW) > TOP_N / 2
    assert (coarse_code(9.0, True, LAW), coarse_code(-9.0, False, LAW), coarse_code(-1.0, True, LAW)) == (255, 1, 0)


@given(
    st.lists(st.integers(-5000, 5000), min_size=8, max_size=8),
    st.lists(st.integers(-FINE_LIMIT, FINE_LIMIT), min_size=8, max_size=8),
    st.integers(0, 255),
)
@settings(deadline=None)
def test_every_fine_value_within_reach_comes_back(near: list[int], away: list[int], check: int) -> None:
    sent, payload, shown = np.array(near) + np.array(away), np.zeros(8, np.uint8), np.zeros(8)
    pack_fine(sent, check, payload)
    unpack_fine(payload, np.array(near) * LAW.fine_n, LAW, shown)
    assert [fine_steps(value, LAW) for value in shown] == sent.tolist()
    assert payload[7] == check
    np.testing.assert_allclose(shown, sent * LAW.fine_n)


def test_every_fine_code_comes_back() -> None:
    payload, shown = np.zeros(8, np.uint8), np.zeros(8)
    for low in range(-FINE_REACH, FINE_REACH, 8):
        sent = np.arange(low, low + 8)
        pack_fine(sent, 0, payload)
        unpack_fine(payload, np.zeros(8), LAW, shown)
        np.testing.assert_allclose(shown, sent * LAW.fine_n)


def test_a_check_tells_every_change_of_one_byte_and_all_but_one_in_255_of_two() -> None:
    rng = np.random.default_rng(0)
    payload = rng.integers(0, 256, GROUP_SUMS).astype(np.uint8)

    def checks(place: int) -> np.ndarray:
        """Return what each change of a byte changes in the check: the code is linear."""
        found = []
        for change in range(1, 256):
            other = payload.copy()
            other[place] ^= change
            found.append(check_of(other) ^ check_of(payload))
        return np.array(found)

    changed = [checks(place) for place in range(GROUP_SUMS)]
    for place in range(GROUP_SUMS):
        assert sorted(changed[place].tolist()) == list(range(1, 256))
    for one, two in combinations(range(GROUP_SUMS), 2):
        assert (changed[one][:, None] == changed[two]).sum() == 255


@pytest.mark.parametrize("is_fd", [False, True])
@pytest.mark.parametrize("groups", [1, 2, 4, 8])
def test_identifiers_belong_to_one_frame_and_go_from_urgent_to_fine(groups: int, is_fd: bool) -> None:
    found, firsts = {}, range(0, groups, carried(groups, is_fd))
    nodes = IDENTIFIERS // len(firsts)
    kinds = [*[(level, False) for level in range(LEVELS)], *[(level, True) for level in range(FINE_LEVELS)]]
    for node, group, (level, is_fine) in product(range(nodes), firsts, kinds):
        found[cob_id(node, level, group, is_fine, groups)] = (node, level, group, is_fine)
    assert sorted(found) == list(range(FIRST_COB_ID, 0x581))
    assert all(frame_of(identifier, groups=groups, is_fd=is_fd) == frame for identifier, frame in found.items())
    # Any news before any of a lower level, and before all details, whichever the node.
    order = [(is_fine, -level) for _, (_, level, _, is_fine) in sorted(found.items())]
    assert order == sorted(order)


def test_numbers_are_those_of_the_document() -> None:
    """Whoever builds a board takes them from docs/adaptive.md and the dictionary."""
    assert SendingRule()._asdict() == {
        "noise_ratio": 0.15,
        "variance_ratio": 2,
        "rounding": 0.75,
        "level_ratio": 1.25,
        "doubling": 8,
        "inhibit": 1,
        "fine_ratio": 0.3,
        "fine_wait": 4,
        "refresh": 64,
        "refresh_max": 1024,
        "overdue": 100,
        "zero_refreshes": 6,
        "patience": 24,
    }
    assert (GROUP_SUMS, LEVELS, FINE_LEVELS, KINDS, IDENTIFIERS) == (8, 6, 2, 8, 128)
    assert (PAUSE_MS, SAVING_S, SAVED_FRAMES) == (2, 0.25, 2)
    assert (FINE_REACH, FINE_LIMIT, LAW.fine_n) == (64, 62, 0.5e-3 / 8)


def test_the_check_is_the_crc_8_of_autosar() -> None:
    # The check value of "123456789" is DFh, complemented at the end; eight bytes here, so a value computed by division.
    def slow(payload: bytes) -> int:
        bits = [int(bit) for byte in payload for bit in f"{byte:08b}"] + [0] * 8
        for place in range(8):
            bits[place] ^= 1  # begins with FFh
        for place in range(len(bits) - 8):
            if bits[place]:
                for offset, bit in enumerate("100101111"):
                    bits[place + offset] ^= int(bit)
        return int("".join(map(str, bits[-8:])), 2)

    assert slow(b"123456789") ^ 0xFF == 0xDF
    rng = np.random.default_rng(4)
    for _ in range(20):
        payload = rng.integers(0, 256, 8).astype(np.uint8)
        assert check_of(payload) == slow(payload.tobytes())


@pytest.mark.parametrize("is_mean", [False, True])
@pytest.mark.parametrize("law", [LAW, companding(0.02, 0.02, BLOCK_SUMS), companding(0.02, 1e-6, BLOCK_SUMS)])
def test_sums_have_the_same_code_or_another(is_mean: bool, law: Companding) -> None:
    rng = np.random.default_rng(3)
    one_n = rng.normal(0, 1, 4000) * 10 ** rng.uniform(-5, 0.5, 4000)
    apart_n = [coarse_step(each, is_mean, law) for each in one_n] * rng.uniform(-3, 3, 4000)
    for first_n, second_n in zip(one_n, one_n + apart_n, strict=True):
        expected = coarse_code(first_n, is_mean, law) == coarse_code(second_n, is_mean, law)
        assert has_same_code(first_n, second_n, is_mean, law) == expected
