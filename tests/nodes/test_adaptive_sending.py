"""When an adaptive node sends which sums."""

import numpy as np
import pytest

from dbc.adaptive import (
    FINE_LEVELS,
    GROUP_SUMS,
    LEVELS,
    SendingRule,
    coarse_code,
    coarse_step,
    coarse_value,
    companding,
)
from nodes.adaptive.sending import (
    DETAIL,
    NEWS,
    NOT_DUE,
    REFRESH,
    Groups,
    ask,
    decide,
    frame_level,
    log2_of,
    make_payload,
    new_groups,
    noise_threshold_n2,
    note_sent,
    urgency,
)
from skin.walsh import walsh_matrix
from tests.layouts import BLOCK_SUMS, GROUPS

LAW, RULE = companding(0.02, 0.5e-3, BLOCK_SUMS), SendingRule()
VARIANCE_N2 = np.full(32, 1e-12, np.float32)
NOISE_N2 = float(noise_threshold_n2(np.array([0.1e-3]), RULE.noise_ratio, BLOCK_SUMS)[0])
NOTHING = np.zeros(32, np.float32)
PRESSED = (walsh_matrix(32) @ np.random.default_rng(0).uniform(0.002, 0.012, 32)).astype(np.float32)
#: Ratios of difference over threshold, from just above 1 on.
RATIOS = np.exp2(np.random.default_rng(0).uniform(0, 40, 100_000))


def looked(groups: Groups, now: int, sums_n: np.ndarray) -> list[int]:
    decide(0, now, sums_n, VARIANCE_N2, NOISE_N2, RULE, LAW, groups)
    return groups.level[0].tolist()


def sent(groups: Groups, now: int, sums_n: np.ndarray) -> list[tuple[int, int, int, bool]]:
    """Send all that is to be sent at once: time, group, reason, whether fine."""
    looked(groups, now, sums_n)
    frames = []
    for group in range(GROUPS):
        if groups.level[0, group] != NOT_DUE:
            frames.append((now, group, int(groups.reason[0, group]), bool(groups.is_fine[0, group])))
            send(groups, group, now, sums_n)
    return frames


def send(groups: Groups, group: int, now: int, sums_n: np.ndarray, rule: SendingRule = RULE) -> None:
    payload = np.zeros(8, np.uint8)
    make_payload(0, group, sums_n, LAW, groups, payload)
    note_sent(0, group, now, bool(groups.is_fine[0, group]), rule, LAW, groups, payload)


def test_an_idle_node_is_silent() -> None:
    groups = new_groups(1, GROUPS)
    assert not [frame for now in range(5000) for frame in sent(groups, now, NOTHING)]


def test_news_is_sent_at_once_then_details_then_refreshes_that_double() -> None:
    groups = new_groups(1, GROUPS)
    frames = [frame for now in range(4000) for frame in sent(groups, now, PRESSED)]
    for group in range(GROUPS):
        mine = [frame for frame in frames if frame[1] == group]
        assert mine[0] == (0, group, NEWS, False)
        details = [now for now, _, reason, _ in mine if reason == DETAIL]
        assert details[0] == RULE.fine_wait
        # A refreshed coarse value may contradict the finer one: then it is refined again.
        coarse = {now for now, _, _, is_fine in mine if not is_fine}
        assert {now - RULE.fine_wait for now in details} <= coarse
        refreshes = [(now, is_fine) for now, _, reason, is_fine in mine if reason == REFRESH]
        assert refreshes == [(64, False), (192, True), (448, False), (960, True), (1984, False), (3008, True)]


def test_what_a_node_has_said_is_off_by_no_more_than_a_fine_step() -> None:
    groups = new_groups(1, GROUPS)
    for now in range(10):
        sent(groups, now, PRESSED)
    assert np.abs(groups.known_n[0] - PRESSED).max() <= 0.51 * LAW.fine_n


def test_a_group_at_zero_stops_after_its_refreshes() -> None:
    groups = new_groups(1, GROUPS)
    for now in range(100):
        sent(groups, now, PRESSED)
    frames = [frame for now in range(100, 9000) for frame in sent(groups, now, NOTHING)]
    for group in range(GROUPS):
        reasons = [reason for _, each, reason, _ in frames if each == group]
        assert reasons == [NEWS] + [REFRESH] * RULE.zero_refreshes
    assert max(now for now, *_ in frames) < 4500
    assert not groups.known_n.any()


def test_larger_and_older_news_is_more_urgent() -> None:
    small, large = new_groups(1, GROUPS), new_groups(1, GROUPS)
    nudge = NOTHING.copy()
    nudge[::GROUP_SUMS] = 0.4e-3
    assert all(0 <= one < other for one, other in zip(looked(small, 0, nudge), looked(large, 0, PRESSED), strict=True))
    assert looked(large, 0, PRESSED)[0] == LEVELS - 2
    waiting = [looked(small, now, nudge)[1] for now in range(100)]
    assert waiting == sorted(waiting)
    assert waiting[0] < waiting[-1] == LEVELS - 1


def test_the_highest_level_is_for_news_that_waited() -> None:
    groups = new_groups(1, GROUPS)
    levels = [looked(groups, now, PRESSED * (1 + now)) for now in range(RULE.patience + 1)]
    assert {level for each in levels[:-1] for level in each} == {LEVELS - 2}
    assert levels[-1] == [LEVELS - 1] * GROUPS


def test_a_fine_refresh_that_waits_becomes_coarse_because_fine_frames_know_no_high_level() -> None:
    groups = new_groups(1, GROUPS)
    for now in range(100):
        sent(groups, now, PRESSED)
    due = int(groups.refresh_at[0, 0])
    looked(groups, due, PRESSED)
    assert groups.is_fine[0, 0]
    looked(groups, due + FINE_LEVELS * RULE.overdue, PRESSED)
    assert (groups.is_fine[0, 0], groups.level[0, 0]) == (0, FINE_LEVELS)


def test_noise_below_the_threshold_is_no_news() -> None:
    groups, rng = new_groups(1, GROUPS), np.random.default_rng(1)
    for now in range(10):
        sent(groups, now, PRESSED)
    for now in range(10, 60):
        assert not sent(groups, now, PRESSED + rng.normal(0, 0.01e-3, 32).astype(np.float32))


def test_a_refresh_that_waits_goes_up_and_details_never_reach_the_level_of_news() -> None:
    groups = new_groups(1, GROUPS)
    for now in range(10):
        sent(groups, now, PRESSED)
    levels = [looked(groups, now, PRESSED)[0] for now in range(64, 1000)]
    assert levels == [min(5, waited // 100) for waited in range(936)]
    groups.is_fine[0, 0] = 1
    assert frame_level(0, 0, groups) == 1


def test_a_node_leaves_time_between_two_frames_of_a_group() -> None:
    groups, rng, last = new_groups(1, GROUPS), np.random.default_rng(2), dict.fromkeys(range(GROUPS), -5)
    rule = SendingRule(inhibit=5)
    for now in range(200):
        decide(0, now, rng.uniform(-0.1, 0.1, 32).astype(np.float32), VARIANCE_N2, NOISE_N2, rule, LAW, groups)
        for group in range(GROUPS):
            if groups.level[0, group] != NOT_DUE:
                assert now - last[group] == 5  # at once when it is over: there is always news
                last[group] = now
                send(groups, group, now, PRESSED, rule)


def test_a_coarse_frame_that_would_change_nothing_is_no_news() -> None:
    """The sum and what is known of it are at the two ends of one code: the code again tells the receiver nothing."""
    groups, step_n = new_groups(1, GROUPS), coarse_step(0.3, False, LAW)
    assert (0.9 * step_n) ** 2 > 100 * NOISE_N2
    held_n, sums_n = PRESSED.copy(), PRESSED.copy()
    low_n = coarse_value(coarse_code(0.3, False, LAW), False, LAW) - 0.45 * step_n
    held_n[1], sums_n[1] = low_n, low_n + 0.9 * step_n
    assert coarse_code(float(sums_n[1]), False, LAW) == coarse_code(float(held_n[1]), False, LAW)
    sent(groups, 0, held_n)
    groups.known_n[0] = held_n
    assert NEWS not in [reason for now in range(1, 50) for _, _, reason, _ in sent(groups, now, sums_n)]


def test_a_group_that_details_lift_from_zero_is_refreshed_for_ever() -> None:
    groups, faint_n = new_groups(1, GROUPS), np.zeros(32, np.float32)
    for now in range(3):
        sent(groups, now, PRESSED)
    for now in range(3, 8000):
        sent(groups, now, NOTHING)
    assert not groups.refreshes[0].any()
    faint_n[1] = 3 * LAW.fine_n
    frames = [frame for now in range(8000, 20_000) for frame in sent(groups, now, faint_n)]
    assert frames[0][2:] == (DETAIL, True)
    assert frames[-1][0] > 20_000 - 2 * RULE.refresh_max


def test_a_tiny_number_of_the_rule_leaves_news_its_highest_level() -> None:
    rule, groups = RULE._replace(level_ratio=1e-30), new_groups(1, GROUPS)
    decide(0, 0, PRESSED, VARIANCE_N2, NOISE_N2, rule, LAW, groups)
    assert groups.level[0].tolist() == [LEVELS - 2] * GROUPS


def test_news_that_is_asked_for_does_not_wait_for_a_budget() -> None:
    groups = new_groups(1, GROUPS)
    ask(0, 1, 0, groups)
    looked(groups, 0, PRESSED)
    assert groups.reason[0].tolist() == [NEWS, REFRESH, NEWS, NEWS]


def test_who_asks_again_does_not_begin_the_wait_anew() -> None:
    groups = new_groups(1, GROUPS)
    for now in range(0, 600, 100):
        ask(0, 1, now, groups)
        looked(groups, now, PRESSED if now == 300 else NOTHING)  # news has its own level, or a higher one
        assert groups.level[0, 1] >= now // RULE.overdue
    assert groups.level[0, 1] == LEVELS - 1


def test_the_logarithm_is_right_to_the_last_bits_and_whole_for_powers_of_two() -> None:
    found = np.array([log2_of(ratio) for ratio in RATIOS])
    np.testing.assert_allclose(found, np.log2(RATIOS), rtol=4e-16, atol=1e-15)
    assert [log2_of(2.0**power) for power in range(-1074, 1024)] == list(range(-1074, 1024))


@pytest.mark.heavy
@pytest.mark.parametrize("waited", [0, 1, 2, 8, 23])
def test_levels_are_those_of_a_librarys_logarithm(waited: int) -> None:
    exact = (np.log2(RATIOS) + waited / RULE.doubling) / RULE.level_ratio
    expected = np.minimum(np.floor(exact), LEVELS - 2).astype(int)
    assert [urgency(ratio, waited, RULE) for ratio in RATIOS] == expected.tolist()


def test_news_that_has_waited_has_the_highest_level_alone() -> None:
    assert urgency(1e30, RULE.patience - 1, RULE) == LEVELS - 2
    assert urgency(1.0001, RULE.patience, RULE) == LEVELS - 1


def test_a_tiny_number_of_the_rule_makes_no_higher_level() -> None:
    assert urgency(3.0, 1, RULE._replace(doubling=1e-40, level_ratio=1e-40)) == LEVELS - 2
