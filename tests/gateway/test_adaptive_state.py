"""The gateway's copy of adaptive sums, with and without losses.

Tested here: while every loss is known to the receiver before the next frame, no fine frame is misread. A loss that is
not known can have a fine frame misread only where the lost coarse frame has the check of the one that is held.
"""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from dbc.adaptive import GROUP_SUMS, NO_CHECK, SendingRule, check_of, coarse_code, cob_id, companding, fine_steps
from gateway.adaptive_state import FOREIGN, MALFORMED, UNREFINED, USED, BusSums, new_sums
from nodes.adaptive.sending import NOT_DUE, Groups, decide, frame_level, new_groups
from tests.bus.harness import frame
from tests.gateway.boards import send
from tests.layouts import BLOCK_SUMS, GROUPS
from tests.nodes.adaptive_bus import receive

LAW, RULE = companding(0.02, 0.5e-3, BLOCK_SUMS), SendingRule()
VARIANCE_N2 = np.zeros(32, np.float32)
#: A step of the sums: how far, in fine steps, from small ones that are details to jumps; and which frames are lost.
STEPS = st.lists(
    st.tuples(st.sampled_from([0, 3, 20, 60, 200, 2000]), st.integers(0, 2**32), st.integers(0, 15)),
    min_size=1,
    max_size=40,
)


def frames_of(groups: Groups, sums_n: np.ndarray, now: int) -> list[tuple[int, int, bool, np.ndarray]]:
    """Return what a node sends of its sums: group, identifier, whether fine, payload."""
    decide(0, now, sums_n, VARIANCE_N2, 1e-9, RULE, LAW, groups)
    sent = []
    for group in range(GROUPS):
        if groups.level[0, group] != NOT_DUE:
            is_fine = bool(groups.is_fine[0, group])
            can_id = cob_id(0, frame_level(0, group, groups), group, is_fine, GROUPS)
            payload = send(groups, group, now, sums_n, LAW)
            sent.append((group, can_id, is_fine, payload))
    return sent


def moved(sums_n: np.ndarray, size: int, seed: int) -> np.ndarray:
    steps = np.random.default_rng(seed).integers(-size, size + 1, 32)
    other = np.clip(sums_n + steps * LAW.fine_n, -0.3, 0.3)
    other[0] = abs(other[0])
    return other.astype(np.float32)


def right(sums: BusSums, group: int, sums_n: np.ndarray, payload: np.ndarray, is_fine: bool) -> bool:
    """Whether what the receiver shows of a group is what a frame says."""
    mine = slice(GROUP_SUMS * group, GROUP_SUMS * (group + 1))
    shown = sums.value_n[0, mine]
    if is_fine:
        steps = [fine_steps(float(value), LAW) for value in sums_n[mine]]
        return bool(np.allclose(shown, np.array(steps) * LAW.fine_n, atol=1e-12))
    return [coarse_code(value, group + place == 0, LAW) for place, value in enumerate(shown)] == payload.tolist()


@given(STEPS)
@settings(max_examples=60, deadline=None)
def test_while_losses_are_known_no_frame_is_misread(steps: list[tuple[int, int, int]]) -> None:
    groups, sums, sums_n = new_groups(1, GROUPS), new_sums(1, GROUPS), np.zeros(32, np.float32)
    for number, (size, seed, lost) in enumerate(steps):
        sums_n = moved(sums_n, size, seed)
        for group, can_id, is_fine, payload in frames_of(groups, sums_n, 5 * number):
            if lost >> group & 1:
                sums.is_lost[:] = True
                continue
            used = sums.counts[USED]
            receive(frame(can_id, payload.tobytes()), LAW, sums)
            assert is_fine or sums.counts[USED] == used + 1
            if sums.counts[USED] > used:
                assert right(sums, group, sums_n, payload, is_fine)


@given(STEPS)
@settings(max_examples=60, deadline=None)
def test_a_silent_loss_is_misread_only_where_the_check_collides(steps: list[tuple[int, int, int]]) -> None:
    groups, sums, sums_n = new_groups(1, GROUPS), new_sums(1, GROUPS), np.zeros(32, np.float32)
    held, refined = {}, {}
    for number, (size, seed, lost) in enumerate(steps):
        sums_n = moved(sums_n, size, seed)
        for group, can_id, is_fine, payload in frames_of(groups, sums_n, 5 * number):
            if not is_fine:
                refined[group] = payload
            if lost >> group & 1:
                continue
            used = sums.counts[USED]
            receive(frame(can_id, payload.tobytes()), LAW, sums)
            if not is_fine:
                held[group] = payload
            if sums.counts[USED] > used and not right(sums, group, sums_n, payload, is_fine):
                one, other = held[group], refined[group]
                assert is_fine
                assert (one != other).sum() >= 2
                assert check_of(one) == check_of(other)


def test_without_losses_the_gateway_knows_what_the_node_thinks_it_knows() -> None:
    groups, sums, sums_n = new_groups(1, GROUPS), new_sums(1, GROUPS), np.zeros(32, np.float32)
    for number, size in enumerate([2000, 3, 20, 0, 60, 3, 3, 0, 200, 20] * 5):
        sums_n = moved(sums_n, size, number)
        for _, can_id, _, payload in frames_of(groups, sums_n, 5 * number):
            receive(frame(can_id, payload.tobytes()), LAW, sums)
        np.testing.assert_allclose(sums.value_n, groups.known_n, atol=1e-12)
    assert sums.counts[UNREFINED] == 0


def test_a_gateway_that_joins_late_waits_for_coarse_frames() -> None:
    groups, sums_n = new_groups(1, GROUPS), moved(np.zeros(32, np.float32), 2000, 1)
    frames_of(groups, sums_n, 0)
    sums = new_sums(1, GROUPS)
    for number in (1, 2):
        sums_n = moved(sums_n, 1, number)
        for _, can_id, is_fine, payload in frames_of(groups, sums_n, 5 * number):
            assert is_fine
            receive(frame(can_id, payload.tobytes()), LAW, sums)
    assert sums.counts[USED] == 0
    assert sums.counts[UNREFINED] > 0
    assert not sums.value_n.any()
    refreshed = [each for now in range(64, 200) for each in frames_of(groups, sums_n, now)]
    for _, can_id, _, payload in refreshed:
        receive(frame(can_id, payload.tobytes()), LAW, sums)
    assert (sums.coarse_ns >= 0).all()
    np.testing.assert_allclose(sums.value_n, groups.known_n, atol=1e-12)


def test_frames_that_are_no_adaptive_sums_change_nothing() -> None:
    sums = new_sums(2, GROUPS)
    for can_id, length in (
        (0x80, 1),
        (0x701, 1),
        (cob_id(2, 5, 0, False, GROUPS), 8),
        (cob_id(1, 5, 0, False, GROUPS), 7),
    ):
        receive(frame(can_id, bytes(length)), LAW, sums)
    assert (sums.counts[FOREIGN], sums.counts[MALFORMED]) == (3, 1)
    assert sums.counts.sum() == 5  # SYNC is counted with its kind, too
    assert (sums.check == NO_CHECK).all()
