"""No fine frame is ever misread while each loss is noticed by the time that the next frame is read.

Nodes send by their own rule, frames are read in batches, and any of them may be lost. A receiver's drop counter tells
of a loss with the batch that holds the next frame, as a kernel's does, but not where in the batch.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dbc.adaptive import GROUP_SUMS, NO_CHECK, SendingRule, coarse_code, coarse_value, companding
from dbc.frame import FD, Frames, frame_bytes, frames
from gateway.adaptive_state import MALFORMED, UNREFINED, USED, BusSums, new_sums, take_all
from nodes.adaptive.sending import NEWS, decide, new_groups
from tests.bus.harness import frame
from tests.gateway.boards import send
from tests.layouts import BLOCK_SUMS, GROUPS
from tests.nodes.adaptive_bus import due_frames

LAW, RULE = companding(0.02, 0.5e-3, BLOCK_SUMS), SendingRule()
VARIANCE_N2 = np.zeros(32, np.float32)
PLACES = [slice(GROUP_SUMS * group, GROUP_SUMS * (group + 1)) for group in range(GROUPS)]
#: A step: how far the sums move, in fine steps; seed; which groups' frames are lost; whether the receiver reads now.
STEPS = st.lists(
    st.tuples(st.sampled_from([0, 1, 3, 20, 60, 200, 2000]), st.integers(0, 2**32), st.integers(0, 15), st.booleans()),
    min_size=1,
    max_size=30,
)


class Sender:
    """A node, and all that it ever sent."""

    def __init__(self, *, is_fd: bool = False) -> None:
        self.groups, self.sums_n, self.now = new_groups(1, GROUPS, is_fd), np.zeros(32, np.float32), 0
        self._is_fd = is_fd
        self.ever: list[set[float]] = [set() for _ in range(32)]
        #: Number, kind and values of the newest frame of each group, as a receiver without losses holds them.
        self.newest: dict[int, tuple[int, bool, np.ndarray]] = {}
        self._number = 0

    def move(self, size: int, seed: int) -> None:
        steps = np.random.default_rng(seed).integers(-size, size + 1, 32)
        self.sums_n = np.clip(self.sums_n + steps * LAW.fine_n, -0.3, 0.3).astype(np.float32)
        self.sums_n[0] = abs(self.sums_n[0])

    def send(self, *, again: bool = False) -> list[tuple[int, Frames]]:
        """Return the frames of a moment, with their groups; on CAN FD at most one, of all groups."""
        self.now += 5
        decide(0, self.now, self.sums_n, VARIANCE_N2, 1e-9, RULE, LAW, self.groups)
        sent, groups = [], self.groups
        for group in range(GROUPS):
            if again:
                groups.level[0, group], groups.reason[0, group], groups.is_fine[0, group] = 0, NEWS, 0
        for group, can_id in due_frames(groups):
            is_fine = bool(groups.is_fine[0, group])
            payload = send(groups, group, self.now, self.sums_n, LAW)
            self._number += 1
            for each in range(GROUPS) if self._is_fd else (group,):
                self.newest[each] = self._number, is_fine, groups.known_n[0, PLACES[each]].copy()
                for place in range(32)[PLACES[each]]:
                    self.ever[place].add(float(groups.known_n[0, place]))
                    if self._is_fd or not is_fine:
                        code = payload[place if self._is_fd else place % GROUP_SUMS]
                        self.ever[place].add(coarse_value(int(code), place == 0, LAW))
            flags = FD if self._is_fd else 0
            sent.append((group, frame(can_id, payload.tobytes(), flags=flags, time_ns=self._number)))
        return sent


class Receiver:
    """Reads what was not lost; a loss is noticed with the next frame that is read."""

    def __init__(self, *, is_fd: bool = False) -> None:
        self.sums: BusSums = new_sums(1, GROUPS)
        self._is_fd = is_fd
        self._waiting: list[Frames] = []
        self._has_gap = False
        self._changed = np.zeros((1, GROUPS), np.bool_)

    def arrive(self, came: Frames, *, is_lost: bool) -> None:
        if is_lost:
            self._has_gap = True
        else:
            self._waiting.append(came)

    def read(self) -> bool:
        """Return whether all losses so far are noticed."""
        if self._waiting:
            batch = np.concatenate([*self._waiting, frames(0)])
            rows = frame_bytes(batch)
            take_all(rows, self._has_gap, LAW, np.ones(1, np.bool_), self.sums, self._changed, self._is_fd)
            self._waiting, self._has_gap = [], False
        return not self._has_gap


def check(sums: BusSums, node: Sender) -> None:
    for group, mine in enumerate(PLACES):
        if sums.check[0, group] == NO_CHECK:
            continue
        held_n = sums.value_n[0, mine]
        assert all(float(held_n[place]) in node.ever[place + mine.start] for place in range(GROUP_SUMS))
        if sums.is_lost[0, group]:
            continue
        # Nothing was lost since the newest coarse frame: it is that of the node, and so is every code.
        np.testing.assert_array_equal(sums.coarse_n[0, mine], node.groups.coarse_n[0, mine])
        number, is_fine, values_n = node.newest[group]
        assert sums.seen_ns[0, group] == number
        if is_fine:
            np.testing.assert_array_equal(held_n, values_n)
        else:
            codes = [
                [coarse_code(float(value), group + place == 0, LAW) for place, value in enumerate(each)]
                for each in (held_n, values_n)
            ]
            assert codes[0] == codes[1]


@pytest.mark.heavy
@given(STEPS, st.booleans())
@settings(max_examples=120, deadline=None)
def test_no_frame_is_misread_and_a_refresh_makes_whole(steps: list[tuple[int, int, int, bool]], is_fd: bool) -> None:
    node, receiver = Sender(is_fd=is_fd), Receiver(is_fd=is_fd)
    for size, seed, lost, reads in steps:
        node.move(size, seed)
        for group, came in node.send():
            receiver.arrive(came, is_lost=bool(lost >> group & 1))
        if reads and receiver.read():
            check(receiver.sums, node)
    receiver.read()
    # A loss is noticed with the first refresh at the latest; the second makes whole.
    for again in (True, True, False, False):
        for _, came in node.send(again=again):
            receiver.arrive(came, is_lost=False)
        receiver.read()
    check(receiver.sums, node)
    assert not receiver.sums.is_lost.any()


@pytest.mark.heavy
@given(STEPS)
@settings(max_examples=50, deadline=None)
def test_after_a_loss_that_nobody_noticed_no_frame_counts_that_has_another_check(
    steps: list[tuple[int, int, int, bool]],
) -> None:
    """A fine frame can be misread only when the check of its coarse frame is that of the one which is held."""
    node, sums = Sender(), new_sums(1, GROUPS)
    changed = np.zeros((1, GROUPS), np.bool_)
    for size, seed, lost, _ in steps:
        node.move(size, seed)
        for group, came in node.send():
            if lost >> group & 1:
                continue
            held, was_lost = int(sums.check[0, group]), bool(sums.is_lost[0, group])
            used, unrefined = int(sums.counts[USED]), int(sums.counts[UNREFINED])
            rows = frame_bytes(came)
            take_all(rows, False, LAW, np.ones(1, np.bool_), sums, changed)
            if node.newest[group][1] and (was_lost or held != int(came["data"][0, 7])):
                assert (sums.counts[USED], sums.counts[UNREFINED]) == (used, unrefined + 1)
                assert sums.is_lost[0, group]
            else:
                assert sums.counts[USED] == used + 1


@pytest.mark.heavy
@given(STEPS)
@settings(max_examples=60, deadline=None)
def test_on_can_fd_any_frame_alone_makes_a_block_whole(steps: list[tuple[int, int, int, bool]]) -> None:
    """Nobody notices a loss, and no frame is misread: each carries the coarse codes that it refines."""
    node, sums = Sender(is_fd=True), new_sums(1, GROUPS)
    changed = np.zeros((1, GROUPS), np.bool_)
    for size, seed, lost, _ in steps:
        node.move(size, seed)
        for _, came in node.send():
            if lost & 1:
                continue
            assert take_all(frame_bytes(came), False, LAW, np.ones(1, np.bool_), sums, changed, True) > 0
            assert changed.all()
            check(sums, node)
    assert (sums.counts[MALFORMED], sums.counts[UNREFINED]) == (0, 0)


def test_a_fine_frame_whose_parts_do_not_belong_together_is_malformed() -> None:
    node, receiver = Sender(is_fd=True), Receiver(is_fd=True)
    node.move(200, 1)
    for number in range(60):
        for _, came in node.send():
            if came["length"][0] == 64:
                came["data"][0, 39] ^= 1
                receiver.arrive(came, is_lost=False)
        if number % 20 == 0:
            node.move(20, number)
    receiver.read()
    assert receiver.sums.counts[MALFORMED] > 0 == receiver.sums.counts[USED]
    assert not receiver.sums.value_n.any()
