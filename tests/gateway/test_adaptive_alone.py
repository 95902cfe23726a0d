"""Adaptive sums without a master's answers: when a measurement is due, and what frames, gaps and proofs do to it."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

import gateway.adaptive_gathering
from bus.link import State
from canskin.messages import UNKNOWN_ERROR_NS, BlockState, Measurement
from dbc.contract import Contract, sample_age_ns
from dbc.frame import Frames, frames
from gateway.adaptive_gathering import AdaptiveGathering
from gateway.gathering import Health, Sync
from gateway.nmt_master import NmtMaster
from tests.bus.harness import frame
from tests.gateway.boards import Board

START_S = 100.0


class Skin:
    """A gathering of four boards on two buses that began at 100 s; nobody answers what it asks."""

    def __init__(self, contract: Contract) -> None:
        self.contract = contract
        self.asked: list[tuple[int, Any]] = []
        self.health = [Health(), Health()]
        masters = {bus: cast("NmtMaster", self._master(bus)) for bus in (0, 1)}
        self.gathering = AdaptiveGathering(contract, masters, START_S, (500.0, 4.0))

    def _master(self, bus: int) -> SimpleNamespace:
        def ask(node_id: int, steps: Any, _now_s: float) -> None:
            self.asked.append((2 * bus + node_id - 1, next(steps)))

        return SimpleNamespace(node_ids=[1, 2], nodes={}, ask=ask)

    def take(
        self,
        bus: int,
        burst: Frames,
        now_s: float,
        *,
        state: State = State.ACTIVE,
        dropped: int = 0,
        stamp_error_ns: int | None = None,
    ) -> None:
        self.health[bus].look(burst, state, dropped, stamp_error_ns)
        self.gathering.take(bus, burst, self.health[bus], now_s)

    def prove(self, *blocks: int, now_s: float = START_S) -> None:
        for block in blocks:
            self.gathering.trust(self.contract.nodes[block], proven=True)
        self.gathering.tick(now_s)

    def measured(self, now_s: float) -> Measurement:
        (made,) = self.gathering.measurements(now_s, 9)
        return made


def sent_by(contract: Contract, block: int, ended_ns: int) -> Frames:
    """Return the first frames of a board: all groups, coarse."""
    board = Board(contract, contract.nodes[block])
    board.sums_n[:] = 0.01
    board.again(0b1111)
    burst: Frames = np.concatenate(board.send(1000))
    burst["time_ns"] = ended_ns
    return burst


@pytest.fixture
def skin(adaptive: Contract) -> Skin:
    return Skin(adaptive)


def test_a_measurement_is_due_soon_after_news_and_else_at_the_least_rate(skin: Skin, adaptive: Contract) -> None:
    gathering = skin.gathering
    assert (gathering.due_s, gathering.may_sleep_until_s) == (START_S + 0.25, START_S + 0.001)
    assert gathering.measurements(START_S + 0.2499, 9) == []
    first = skin.measured(START_S + 0.25)
    assert (first.cycle, first.sync_counter, first.wall_offset_ns) == (1, 0, 9)
    assert gathering.due_s == pytest.approx(START_S + 0.5, abs=1e-6)
    skin.prove(0)
    assert gathering.due_s == pytest.approx(START_S + 0.252, abs=1e-6)  # what was held of the node is forgotten
    skin.measured(START_S + 0.3)
    skin.take(0, frame(0x555), START_S + 0.31)
    assert gathering.due_s == pytest.approx(START_S + 0.55, abs=1e-6)
    skin.take(0, sent_by(adaptive, 0, 5), START_S + 0.31)
    assert gathering.due_s == pytest.approx(START_S + 0.302, abs=1e-6)
    skin.measured(START_S + 0.32)
    assert gathering.due_s == pytest.approx(START_S + 0.57, abs=1e-6)
    assert gathering.published == 3
    assert gathering.complete == 0


def test_a_measurement_tells_of_the_newest_frame_and_sync(skin: Skin, adaptive: Contract) -> None:
    skin.prove(0, 2)
    skin.gathering.begin(Sync(7, 3, 0, None, 0))
    made = skin.measured(START_S + 1)
    assert (made.sync_counter, made.sampled_mono_ns, made.sampled_error_ns) == (3, 100_000_000_000, UNKNOWN_ERROR_NS)
    ended_ns = 101_000_000_000
    skin.take(1, sent_by(adaptive, 2, ended_ns), START_S + 1, stamp_error_ns=500)
    skin.take(0, sent_by(adaptive, 0, ended_ns - 4000), START_S + 1, stamp_error_ns=800)
    made = skin.measured(START_S + 2)
    assert made.sampled_mono_ns == ended_ns
    assert made.sampled_error_ns == sample_age_ns(adaptive.layout.bus[1]) + 500
    assert np.frombuffer(made.bus_sampled_ns, "<i8").tolist() == [ended_ns - 4000, ended_ns]
    skin.take(0, sent_by(adaptive, 0, ended_ns + 1000), START_S + 1, stamp_error_ns=None)
    made = skin.measured(START_S + 3)
    assert (made.sampled_mono_ns, made.sampled_error_ns) == (ended_ns + 1000, UNKNOWN_ERROR_NS)
    assert np.frombuffer(made.bus_sampled_ns, "<i8").tolist() == [ended_ns + 1000, ended_ns]


def test_a_node_counts_from_its_proof_on_and_is_forgotten_with_its_doubt(skin: Skin, adaptive: Contract) -> None:
    node, burst = adaptive.nodes[1], sent_by(adaptive, 1, 100_200_000_000)
    skin.take(0, burst, START_S + 0.2)
    assert skin.gathering.counts.unproven == len(burst)
    skin.gathering.trust(node, proven=True)
    skin.take(0, burst, START_S + 0.2)  # they came together with the end of the proof
    assert skin.gathering.counts.unproven == 2 * len(burst)
    skin.take(0, burst, START_S + 0.2)
    assert skin.gathering.counts.accepted == len(burst)
    made = skin.measured(START_S + 0.25)
    assert list(made.states) == [BlockState.DEAD, BlockState.FRESH, BlockState.DEAD, BlockState.DEAD]
    assert list(made.valid) == [0, 1, 0, 0]
    skin.gathering.trust(node, proven=False)
    made = skin.measured(START_S + 0.26)
    assert list(made.states) == [BlockState.DEAD] * 4
    assert not any(made.known)
    skin.take(0, burst, START_S + 0.3)
    assert skin.gathering.counts.unproven == 3 * len(burst)


def test_a_doubt_before_the_proof_is_used_undoes_it(skin: Skin, adaptive: Contract) -> None:
    skin.gathering.trust(adaptive.nodes[1], proven=True)
    skin.gathering.trust(adaptive.nodes[1], proven=False)
    skin.take(0, frames(0), START_S)
    skin.take(0, sent_by(adaptive, 1, 5), START_S)
    assert skin.gathering.counts.accepted == 0


def test_all_blocks_make_a_complete_measurement(skin: Skin, adaptive: Contract) -> None:
    skin.prove(0, 1, 2, 3)
    for block in range(4):
        skin.take(block // 2, sent_by(adaptive, block, 100_200_000_000), START_S + 0.2)
    made = skin.measured(START_S + 0.25)
    assert list(made.valid) == [1, 1, 1, 1]
    assert (skin.gathering.published, skin.gathering.complete) == (1, 1)


def test_a_gap_is_news_and_a_bus_that_stays_down_is_not(skin: Skin) -> None:
    now_s = START_S

    def is_news(*, state: State = State.ACTIVE, dropped: int = 0) -> bool:
        nonlocal now_s
        now_s += 1.0
        skin.measured(now_s)
        skin.take(0, frames(0), now_s, state=state, dropped=dropped)
        return skin.gathering.due_s == pytest.approx(now_s + 0.002, abs=1e-6)

    assert not is_news()
    assert is_news(dropped=2)
    assert not is_news(dropped=2)
    assert is_news(dropped=2, state=State.BUS_OFF)
    assert not is_news(dropped=2, state=State.BUS_OFF)
    assert is_news(dropped=2)
    assert not is_news(dropped=2)


def test_nodes_of_a_bus_that_is_down_are_asked_nothing(skin: Skin) -> None:
    skin.prove(0, 2)
    asked = {block for block, _ in skin.asked}
    assert asked == {0, 2}  # for their noise
    skin.asked.clear()
    skin.take(0, frames(0), START_S + 1, state=State.LOST)
    skin.gathering.tick(START_S + 5)
    assert {block for block, _ in skin.asked} == {2}
    skin.take(0, frames(0), START_S + 6)
    skin.asked.clear()
    skin.gathering.tick(START_S + 7)
    assert {block for block, _ in skin.asked} == {0, 2}


def test_foreign_syncs_are_counted_from_the_last_question_on(skin: Skin) -> None:
    skin.take(1, np.concatenate([frame(0x80), frame(0x555), frame(0x80, b"\1")]), START_S)
    assert [skin.gathering.take_foreign_syncs(bus) for bus in (0, 1, 1)] == [0, 2, 0]
    skin.take(1, frame(0x80), START_S)
    assert skin.gathering.take_foreign_syncs(1) == 1
    assert skin.gathering.counts.foreign == 4


def test_no_frame_is_due_at_a_time(skin: Skin) -> None:
    assert skin.gathering.missing_and_late(1) == (0, 0)
    assert skin.gathering.in_flight == 0
    assert skin.gathering.disturbance == "no sums start in the 2 ms after each SYNC"


def test_what_runs_for_each_frame_is_compiled_before_the_first(
    adaptive: Contract, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran: list[str] = []

    def take_all(*_: object) -> int:
        ran.append("take_all")
        return 0

    monkeypatch.setattr(gateway.adaptive_gathering, "take_all", take_all)
    monkeypatch.setattr(gateway.adaptive_gathering, "judge", lambda *_: ran.append("judge"))
    Skin(adaptive)
    assert sorted(ran) == ["judge", "take_all", "take_all"]
