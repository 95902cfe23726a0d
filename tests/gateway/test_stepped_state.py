"""The gateway's copy of steps, with losses, late frames, repeated frames, and nodes that start again.

The sender here knows the words (`dbc.steps`) and the rules of slots, and sends what the test says: steps, sets and
checks of any kind, each when it may. So a block that is valid must hold the integers that the sender held when it sent
the newest word that came.
"""

from collections import deque
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dbc.canopen import SYNC_COB_ID
from dbc.contract import Contract
from dbc.frame import ECHO, FD, Frames
from dbc.steps import (
    COUNT,
    KEEP_MIN,
    LATE_SLOTS,
    SCALES,
    SEQUENCE,
    SET_SUMS,
    SLOTS,
    WORD_BYTES,
    check_word,
    set_word,
    slot_byte,
    step_word,
    write_word,
)
from gateway.batch import batch_of
from gateway.block_states import judge, new_states
from gateway.stepped_state import (
    AFTER_GAP,
    DUPLICATE,
    FOREIGN,
    LATE,
    MALFORMED,
    UNPROVEN,
    forget,
    new_sums,
    slots_of,
    take_all,
)
from shell.compiled import hold
from skin.sync_counter import SYNC_OVERFLOW
from tests.bus.harness import frame
from tests.gateway.boards import small_stepped
from tests.layouts import buses
from tests.world import DISTURBANCES, RANDOM

ONE = small_stepped(bus=buses(4))
CONTRACTS = {
    "classic": ONE,
    "two parts": small_stepped(bus=buses(2), measurement={"wiring": "board", "block_size": 64}),
    "CAN FD": small_stepped(bus=buses(4, fd=True, data_bitrate=5_000_000)),
    "at SYNC": small_stepped(bus=buses(4), sync={"rate_hz": 200.0}, steps={"slot_s": 0.005, "at_sync": True}),
}
#: The longest silence of a node, slots.
LONGEST = slots_of(ONE).silence
#: Slots until a gateway that still misses sums asks again.
ASK_AGAIN = 20
#: Slots in which all is whole after a disturbance: a second.
WHOLE = 200
ACTIONS = 30


class Sender:
    """Node 1; `held` are its integers at each word by the number of the word, which it puts into its frames' times."""

    def __init__(self, contract: Contract, seed: int = 0) -> None:
        self.contract, self.forms = contract, contract.nodes[0].forms
        self.tpdos = contract.nodes[0].tpdos
        self.random = np.random.default_rng(seed)
        self.counter = 0
        self.start()

    def start(self) -> None:
        self.known = [np.zeros(form.sums, np.int64) for form in self.forms]
        frames = len(self.tpdos)
        self.count, self.wanted = [0] * frames, [0] * frames
        self.last: list[int | None] = [None] * frames
        self.keep = [KEEP_MIN] * frames

    def ask(self) -> None:
        self.wanted = [0] * len(self.wanted)

    def slot_of(self, since: int) -> int:
        """Return the number of the slot `since` slots after the newest SYNC."""
        return ((self.counter - 1) * self.contract.slots + since) % self.contract.slot_cycle

    def send(self, tpdo: int, slot: int, kind: str = "any") -> Frames | None:
        """Return the frame of a TPDO in a slot; None if its node says nothing."""
        cycle, last = self.contract.slot_cycle, self.last[tpdo]
        since = cycle if last is None else (slot - last) % cycle
        if last is not None and not 0 < since <= cycle - self.contract.slots:
            return None  # the SYNC came late, and the number of the slot once more
        of_frame = len(self.forms) // len(self.tpdos)
        parts = range(tpdo * of_frame, (tpdo + 1) * of_frame)
        is_wanted = self.wanted[tpdo] < self.forms[parts[0]].groups
        if is_wanted:
            kind, group = "set", self.wanted[tpdo]
            self.wanted[tpdo] += 1
        else:
            group = int(self.random.integers(self.forms[parts[0]].groups))
            if kind == "any":
                kind = str(self.random.choice(["step", "step", "step", "set", "nothing", "nothing"]))
        if kind == "step" and since > SEQUENCE:
            kind = "set"
        if kind == "nothing":
            if since < self.keep[tpdo]:
                return None
            kind = "check"
        if kind == "check":
            self.keep[tpdo] = min(2 * self.keep[tpdo], self.contract.keep_max)
        elif not is_wanted:
            self.keep[tpdo] = KEEP_MIN
        data = np.zeros(self.tpdos[tpdo].length, np.uint8)
        data[0] = slot_byte(slot)
        for place, part in enumerate(parts):
            write_word(self.word(part, kind, group, self.count[tpdo], slot), data[1 + WORD_BYTES * place :])
        self.count[tpdo], self.last[tpdo] = (self.count[tpdo] + 1) % COUNT, slot
        return frame(self.tpdos[tpdo].cob_id, data.tobytes(), flags=self.contract.nodes[0].flags)

    def word(self, part: int, kind: str, group: int, count: int, slot: int) -> int:
        form, known = self.forms[part], self.known[part]
        if kind == "check":
            return check_word(known, count, slot, form)
        if kind == "set":
            here = slice(SET_SUMS * group, SET_SUMS * (group + 1))
            known[here] = self.random.integers(0, 4096, len(known[here]))
            return set_word(group, known, count, slot, form)
        scale, most = int(self.random.integers(len(SCALES))), form.radix // 2
        digits = self.random.integers(-most, most + 1, form.sums)
        known += digits * SCALES[scale]
        return step_word(digits, scale, count, form)


class Skin:
    """A sender and its receiver, whose time is counted in slots; words may wait in `line` before they arrive."""

    def __init__(self, contract: Contract = ONE, seed: int = 0) -> None:
        self.contract, self.sender = contract, Sender(contract, seed)
        self.state, self.slots = new_sums(contract), slots_of(contract)
        self.shown = new_states(contract, 0)
        self.is_proven = np.ones(contract.phi.blocks, np.bool_)
        self.known = hold((self.is_proven, self.slots, contract.parts, self.state))
        self.counts_per_unit = 1.0
        #: Slots that have passed, in all and since the newest SYNC was due; by how many the next is late.
        self.now, self.since, self.sync_late = 1000, 0, 0
        self.line: deque[tuple[int, Frames, list[np.ndarray]]] = deque()
        #: What each frame's integers were, by TPDO: those of the newest that has arrived.
        self.newest: dict[int, list[np.ndarray]] = {}
        self.asked = self.now + ASK_AGAIN
        self.sync()

    @property
    def now_ns(self) -> int:
        return self.now * self.slots.slot_ns

    def sync(self, counter: int | None = None) -> None:
        """Let the gateway send the next SYNC; with `counter` another master."""
        if counter is None:
            self.own = getattr(self, "own", 0) % 240 + 1
            self.sender.counter = self.own
            self.arrive(frame(SYNC_COB_ID, bytes((self.own,)), ECHO))
            self.since = max(0, self.since - self.contract.slots)
        else:
            self.sender.counter = counter
            self.arrive(frame(SYNC_COB_ID, bytes((counter,))))
            self.state.missing[:] = (1 << self.contract.parts.form[:, 3]) - 1  # as SteppedGathering does
        self.board_since = 0

    def arrive(self, came: Frames) -> None:
        came["time_ns"] = self.now_ns
        take_all(batch_of(came, 0, self.contract.parts), self.known)

    def put(self, tpdo: int = 0, kind: str = "any", late: int = 0) -> bool:
        """Let a TPDO be sent in this slot, and wait for a while; tell whether it is."""
        sent = self.sender.send(tpdo, self.sender.slot_of(self.board_since), kind)
        if sent is not None:
            held = [each.copy() for each in self.sender.known]
            due = max(self.now + late, self.line[-1][0] if self.line else 0)
            self.line.append((due, sent, held))
        return sent is not None

    def deliver(self) -> None:
        while self.line and self.line[0][0] <= self.now:
            _, came, held = self.line.popleft()
            self.arrive(came)
            self.newest[int(came["can_id"][0])] = held

    def go(self, slots: int = 1, *, is_late: bool = False) -> None:
        """Let time pass, and SYNC come when it is due, or stay away."""
        for _ in range(slots):
            self.now, self.since, self.board_since = self.now + 1, self.since + 1, self.board_since + 1
            if self.since >= self.contract.slots + self.sync_late and not is_late:
                self.sync()

    def look(self) -> bool:
        """Judge, and tell whether the block is valid; a valid block has the integers of the newest words."""
        judge(self.now_ns, self.counts_per_unit, self.known, self.shown)
        if self.shown.valid[0]:
            tpdos, parts = self.sender.tpdos, len(self.sender.forms)
            for part, form in enumerate(self.sender.forms):
                held = self.newest[tpdos[part * len(tpdos) // parts].cob_id][part]
                np.testing.assert_array_equal(self.state.known[part, : form.sums], held)
                np.testing.assert_array_equal(self.shown.sums[0, self.shown.places[self.places(part)]], held)
        return bool(self.shown.valid[0])

    def places(self, part: int) -> slice:
        first = int(self.contract.parts.first[part])
        return slice(first, first + self.sender.forms[part].sums)

    def turn(self, kinds: Sequence[str] | str = "any", *, late: int = 0) -> bool:
        """Send in this slot, deliver, look, ask for what is missing, and go on."""
        for tpdo in range(len(self.sender.tpdos)):
            self.put(tpdo, kinds if isinstance(kinds, str) else kinds[tpdo], late)
        self.deliver()
        is_whole = self.look()
        if self.shown.is_wanted[0] and self.now >= self.asked:
            self.sender.ask()
            self.asked = self.now + ASK_AGAIN
        self.go()
        return is_whole

    def late_turns(self, slots: int) -> None:
        """Let slots pass in which no SYNC comes."""
        for _ in range(slots):
            self.put(kind="step")
            self.deliver()
            self.look()
            self.go(1, is_late=True)

    def until_whole(self, at_most: int = WHOLE, kind: str = "any") -> int:
        for count in range(at_most):
            if self.turn(kind):
                return count
        raise AssertionError((self.state, self.shown))

    def count(self, kind: int) -> int:
        return int(self.state.counts[kind])


@pytest.fixture(params=CONTRACTS)
def skin(request: pytest.FixtureRequest) -> Skin:
    """Return a skin whose node is whole."""
    built = Skin(CONTRACTS[request.param])
    built.until_whole()
    return built


@pytest.fixture
def one() -> Skin:
    """Return the skin of one part, whole; its newest word is one of this slot."""
    built = Skin()
    built.until_whole()
    built.put(kind="step")
    built.deliver()
    assert built.look()
    return built


def test_a_node_is_whole_when_each_group_has_come(skin: Skin) -> None:
    other = Skin(skin.contract)
    groups = max(form.groups for form in other.sender.forms)
    assert other.until_whole() == groups - 1
    assert other.shown.known[0].all()
    assert not other.shown.known[1:].any()
    assert other.shown.states[:2].tolist() == [3, 0]


def test_groups_that_have_come_are_known_before_the_others() -> None:
    skin = Skin()
    skin.put()
    skin.deliver()
    assert not skin.look()
    assert skin.shown.known[0].sum() == SET_SUMS
    assert skin.shown.states[0] == 1
    assert skin.shown.sums[0].any()
    skin.is_proven[0] = False
    skin.look()
    assert skin.shown.states[0] == 0


def loses(lost: int, kind: str, silent: int = 1) -> Callable[[Skin], None]:
    """Lose steps; then a word comes. A step after many slots is none of a board that keeps the rule."""

    def disturb(one: Skin) -> None:
        for _ in range(lost):
            one.go()
            one.put(kind="step")
        one.line.clear()
        one.go(silent)
        one.put(kind=kind)
        one.deliver()

    return disturb


def differs(kind: str, ahead: int = 0) -> Callable[[Skin], None]:
    """Two words of a slot differ, as of two nodes with one identifier, of which one has sent `ahead` words more."""

    def disturb(one: Skin) -> None:
        mine, other = one.sender, Sender(one.contract, seed=1)
        other.count, other.last = [each + ahead for each in mine.count], list(mine.last)
        other.wanted = list(mine.wanted)
        one.go()
        one.put(kind=kind)
        one.deliver()
        assert one.look()
        second = other.send(0, mine.slot_of(one.board_since), kind)
        assert second is not None
        one.arrive(second)

    return disturb


def starts_again_unheard(one: Skin) -> None:
    one.sender.start()
    one.go()
    one.put()
    one.deliver()


def checks_another_sum(one: Skin) -> None:
    one.sender.known[0][5] += 1
    one.go(KEEP_MIN)
    one.put(kind="nothing")
    one.line[0] = (*one.line[0][:2], [])
    one.deliver()


def loses_all_counts(one: Skin) -> None:
    """Words were late before, so that the loss takes less time than the longest silence."""
    late = 300
    for _ in range(2 * late):
        one.turn("step", late=late)
    lost = len(one.line)
    one.line.clear()
    while lost < COUNT:
        lost += one.put(kind="step")
        one.line.clear()
        one.go()
    one.sender.wanted = [99]
    one.put(kind="set")
    one.deliver()
    assert one.state.missing[0]


def loses_words_after_a_late_sync(late: int, lost: int) -> Callable[[Skin], None]:
    """Were the number of a slot used twice, three words would be lost unseen."""

    def disturb(one: Skin) -> None:
        while one.since < one.contract.slots - 1:
            assert one.turn("step")
        one.late_turns(late + 1)
        one.sync()
        left = lost
        while left:
            left -= one.put(kind="step")
            one.line.clear()
            one.go()
        for _ in range(late + 1):
            assert not one.turn("step")

    return disturb


def loses_words_between_foreign_syncs(one: Skin) -> None:
    while one.since:
        assert one.turn("step")
    assert one.turn("step")
    for counter, words in ((99, 1), (one.own, 2)):
        one.sync(counter)
        for _ in range(words):
            assert one.put(kind="step")
            one.go()
    one.line.clear()
    assert not one.turn("step")


#: What makes a block stale at the next word that comes.
SEEN: dict[str, Callable[[Skin], None]] = {
    **{f"{n} lost before a {kind}": loses(n, kind) for n in (1, 2, 3, 4, 100, LONGEST - 1) for kind in ("step", "set")},
    **{f"{n} lost before a check": loses(n, "check") for n in (1, 2, 5, 300)},
    **{
        f"the first byte again in a {kind}": loses(SEQUENCE - 1, kind, SYNC_OVERFLOW - SEQUENCE + 1)
        for kind in ("set", "check")
    },
    **{f"two {kind}s of a slot that differ": differs(kind) for kind in ("step", "set")},
    **{f"a {kind} and the next in one slot": differs(kind, 1) for kind in ("step", "set")},
    **{
        f"{lost} lost {late} slots after SYNC was late": loses_words_after_a_late_sync(late, lost)
        for late in (1, 3)
        for lost in (1, 2, 3, 4)
    },
    "between foreign SYNCs": loses_words_between_foreign_syncs,
    "all counts": loses_all_counts,
    "another sum": checks_another_sum,
    "starts again": starts_again_unheard,
}


@pytest.mark.parametrize("what", SEEN)
def test_what_was_lost_is_seen_at_the_next_word_and_mended(one: Skin, what: str) -> None:
    SEEN[what](one)
    assert not one.look()
    if " lost before " in what:
        assert one.count(AFTER_GAP) + one.count(LATE) == 1
    if what.startswith("two "):
        assert one.count(DUPLICATE) == 1
    one.go()
    one.until_whole()
    assert one.state.different.sum() == (what == "another sum")


@pytest.mark.parametrize("wait", [24, 48, 96, 192, 384, 480])
def test_a_silent_node_is_stale_after_its_own_wait_and_forgotten_after_the_longest(one: Skin, wait: int) -> None:
    """A step, then checks after twice the time each. In the first slots after a SYNC nobody is called silent."""
    while one.sender.keep[0] < wait:
        assert one.turn("nothing")
    silent = one.now - int(one.state.newest_ns[0] // one.slots.slot_ns)
    assert silent <= 1
    while one.look():
        one.go()
        silent += 1
    assert wait + LATE_SLOTS < silent <= wait + 2 * LATE_SLOTS + 2
    assert (one.shown.states[0], one.shown.known[0].all(), one.shown.is_wanted[0]) == (1, True, True)
    one.go(LONGEST + 1 - silent)
    assert not one.look()
    assert (one.shown.states[0], one.shown.known[0].any()) == (0, False)
    one.until_whole()


@pytest.mark.parametrize("silent", [KEEP_MIN + 2 * LATE_SLOTS + 2, LONGEST - LATE_SLOTS - 1])
def test_a_word_in_time_ends_a_silence_without_loss(one: Skin, silent: int) -> None:
    """Of a board whose newest word was lost, or whose slots a late SYNC has moved."""
    one.go(silent)
    assert not one.look()
    assert one.turn("set")


@pytest.mark.parametrize("phase", range(0, 2 * ONE.slots, 2))
def test_nobody_is_called_silent_when_syncs_come_late_and_in_time(one: Skin, phase: int) -> None:
    """Numbers of slots go back at a late SYNC, and forward at the next: there a check may be due."""
    while one.since + one.own % 2 * one.contract.slots != phase:
        assert one.turn("step")
    for _ in range(3 * one.contract.keep_max):
        one.sync_late = one.own % 2 * one.contract.slots // 2
        assert one.look()
        assert one.turn("nothing")
    assert not one.count(AFTER_GAP)


@pytest.mark.heavy
@pytest.mark.parametrize("name", CONTRACTS)
def test_a_board_that_keeps_its_waits_is_never_called_silent(name: str) -> None:
    """Whatever it sends, whenever it is asked, and however late SYNCs are, or frames."""
    contract = CONTRACTS[name]
    kinds = st.sampled_from(["any", "step", "set", "nothing", "nothing"])
    stages = st.lists(st.tuples(kinds, st.integers(1, 700), st.booleans(), st.integers(0, 100)), min_size=2, max_size=5)

    @settings(RANDOM, max_examples=max(20, DISTURBANCES // 100))
    @given(stages, st.booleans(), st.integers(0, 2**32))
    def run(stages: list[tuple], are_syncs_late: bool, seed: int) -> None:
        skin = Skin(contract, seed)
        skin.until_whole()
        for kind, slots, is_asked, late in stages:
            skin.sync_late = late % skin.slots.jump * are_syncs_late
            if is_asked:
                skin.sender.ask()
            for _ in range(slots):
                assert skin.turn(kind, late=0 if are_syncs_late else late % (LATE_SLOTS + 1))
        assert not skin.count(AFTER_GAP)

    run()


@pytest.mark.parametrize("late", [1, 4, 5, 239, 240, LONGEST - 1, LONGEST, SLOTS - 5, SLOTS - 2, SLOTS, SLOTS + 40])
def test_a_late_frame_makes_its_block_not_valid_until_one_comes_in_time(one: Skin, late: int) -> None:
    """As of a board that hangs: meanwhile it sends nothing."""
    one.go()
    one.put(kind="step")
    one.line[0] = (one.now + late, *one.line[0][1:])
    for _ in range(late):
        one.deliver()
        one.look()
        one.go()
    one.deliver()
    assert one.look() == (late <= LATE_SLOTS)
    one.go()
    # The word before came a slot earlier: that silence is longer. A node leaves out slots just below its newest word's.
    took = one.until_whole(kind="step")
    assert took == 0 if late < LONGEST else 11 <= took <= 15


def test_a_repeated_frame_changes_nothing(one: Skin) -> None:
    for kind in ("step", "set", "check"):
        one.go(1 if kind != "check" else KEEP_MIN)
        one.put(kind="nothing" if kind == "check" else kind)
        one.line.append((one.now, one.line[0][1].copy(), one.line[0][2]))
        one.deliver()
        assert one.look()
    assert one.count(DUPLICATE) == 3
    one.go()
    assert one.turn("step")


def test_counts_wrap(one: Skin) -> None:
    for number in range(2 * COUNT):
        assert one.turn("set" if number % 64 == 0 else "step")


def test_a_sync_that_is_late_repeats_slots_and_words_go_on(one: Skin) -> None:
    for late in (1, 2, 5, 12):
        while one.since < one.contract.slots - 1:
            assert one.turn("step")
        one.late_turns(late + 1)
        one.sync()
        for _ in range(late + 2):
            assert one.turn("step")


def test_frames_before_the_first_sync_are_late() -> None:
    skin = Skin()
    skin.state.sync_ns[:] = new_sums(skin.contract).sync_ns
    for _ in range(15):
        skin.put()
        skin.deliver()
        assert not skin.look()
        skin.now, skin.board_since = skin.now + 1, skin.board_since + 1
    assert not skin.state.missing[0]
    skin.sync()
    assert skin.turn("set")


def test_frames_that_are_no_words_of_proven_nodes_change_nothing(one: Skin) -> None:
    before = [each.copy() for each in one.state[:-2]]
    cob_id = one.sender.tpdos[0].cob_id
    one.is_proven[1] = False
    top = (1 << 8 * WORD_BYTES) - 1
    for can_id, data, flags in (
        (0x701, bytes(1), 0),
        (SYNC_COB_ID, b"\1", 0),
        (cob_id, b"\1" + bytes(7), FD),
        (cob_id, b"\1" + bytes(6), 0),
        (cob_id, bytes(8), 0),
        (cob_id, b"\xf1" + bytes(7), 0),
        (cob_id, b"\1" + top.to_bytes(WORD_BYTES, "little"), 0),
        (one.contract.nodes[1].tpdos[0].cob_id, b"\1" + bytes(7), 0),
        (cob_id, b"\1" + bytes(7), ECHO),
    ):
        one.arrive(frame(can_id, data, flags))
    assert [one.count(kind) for kind in (FOREIGN, MALFORMED, UNPROVEN)] == [3, 4, 1]
    for mine, was in zip(one.state[:-2], before, strict=True):
        np.testing.assert_array_equal(mine, was)


action = st.one_of(
    st.tuples(st.just("go"), st.integers(1, 40)),
    st.tuples(st.just("rest"), st.integers(1, 800)),
    st.tuples(st.just("lose"), st.integers(1, 6), st.just(1.0)),
    st.tuples(st.just("lose"), st.integers(1, 1200), st.just(1.0)),
    st.tuples(st.just("lose"), st.integers(1, 300), st.sampled_from([0.01, 0.05, 0.5])),
    st.tuples(st.just("delay"), st.integers(0, SLOTS - LONGEST - 1)),
    st.tuples(st.just("hang"), st.integers(1, SLOTS + 40)),
    st.just(("repeat",)),
    st.tuples(st.just("sync"), st.integers(1, 240)),
    st.tuples(st.just("late_turns"), st.integers(1, 19)),
    st.just(("restart",)),
)


class Disturbances:
    """What disturbs a skin; `Skin.look` checks in every slot."""

    def __init__(self, skin: Skin, seed: int) -> None:
        self.skin, self.random = skin, np.random.default_rng(seed)
        #: How long every frame is under way, slots.
        self.late = 0

    def go(self, slots: int) -> None:
        for _ in range(slots):
            self.skin.turn(late=self.late)

    def rest(self, slots: int) -> None:
        for _ in range(slots):
            self.skin.turn("nothing", late=self.late)

    def lose(self, slots: int, ratio: float) -> None:
        for _ in range(slots):
            before = self.skin.line[-1] if self.skin.line else None
            self.skin.turn(late=self.late + 1)
            while self.skin.line and self.skin.line[-1] is not before and self.random.random() < ratio:
                self.skin.line.pop()

    def delay(self, slots: int) -> None:
        self.late = slots

    def hang(self, slots: int) -> None:
        for tpdo in range(len(self.skin.sender.tpdos)):
            self.skin.put(tpdo, late=slots)
        for _ in range(slots):
            self.skin.go()
            self.skin.deliver()
            self.skin.look()

    def repeat(self) -> None:
        if self.skin.put(0):
            due, came, held = self.skin.line[-1]
            self.skin.line.append((due, came.copy(), held))

    def restart(self) -> None:
        """Let the boot-up message come after all that was sent before."""
        self.skin.sender.start()
        self.skin.line.clear()
        for part in range(len(self.skin.sender.forms)):
            forget(part, self.skin.contract.parts, self.skin.state)


@pytest.mark.heavy
@pytest.mark.parametrize("name", CONTRACTS)
def test_random_disturbances(name: str) -> None:
    """No block is valid and wrong in any slot, and each is whole within a second after the last disturbance."""

    @settings(RANDOM, max_examples=max(5, DISTURBANCES // 10 // ACTIONS))
    @given(st.lists(action, min_size=ACTIONS, max_size=ACTIONS), st.integers(0, 2**32))
    def run(actions: list[tuple], seed: int) -> None:
        skin = Skin(CONTRACTS[name], seed)
        disturbances = Disturbances(skin, seed)
        for what, *given_ in actions:
            getattr(skin if what in {"sync", "late_turns"} else disturbances, what)(*given_)
        disturbances.late = 0
        while skin.line:
            skin.deliver()
            skin.look()
            skin.go()
        skin.until_whole(WHOLE)

    run()
