"""Boards whose values stand still while their frames go on are found, left out, and used again; no living board is."""

from collections.abc import Callable, Generator
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from canskin.messages import Measurement
from dbc import indices as od
from dbc.contract import Contract
from gateway import frozen_boards
from gateway.calibration import GatewayCalibration
from gateway.frozen_boards import NOISY, PERIOD_S, PLACES, RESTS, FrozenBoards
from gateway.sdo import Read, SdoAbortedError
from nodes.sending import sending_of
from skin.defects import Defects, parse_stops
from skin.sources import Frame
from tests.gateway.boards import small_stepped
from tests.layouts import small_contract
from tests.world import World, valid

CONTRACT = small_stepped()
MOST = CONTRACT.layout.taxels.count_max
Counts = npt.NDArray[np.int64]
NOBODY = np.zeros(CONTRACT.phi.blocks, np.bool_)


class Asked:
    """Boards that are only asked; what board 2 tells is the test's, the others have noise. `force` moves its sums."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.found = FrozenBoards(CONTRACT, self.lines.append)
        self.random, self.now_s = np.random.default_rng(1), 0.0
        self.counts: Callable[[], Counts | None] = self.noise
        self.force = 200
        self.asked: list[float] = []

    def noise(self) -> Counts:
        """What an idle taxel reads."""
        return np.clip(self.random.normal(0, 50, 32).round(), 0, MOST).astype(np.int64)

    def ask(self, board: int, steps: Generator[Read, bytes, None], now_s: float) -> object:
        counts = self.counts() if board == 2 else self.noise()
        self.asked += [now_s] if board == 2 else []
        try:
            wanted = next(steps)
            while True:
                assert wanted.index == od.COUNTS
                if counts is None:
                    wanted = steps.throw(SdoAbortedError(wanted, 0x0602_0000))
                else:
                    wanted = steps.send(int(counts[wanted.subindex - 1]).to_bytes(2, "little"))
        except StopIteration:
            return object()

    def run(self, seconds: float) -> list[int]:
        """Return the node-IDs of the frozen boards of the second bus, that of board 2, after some time."""
        masters: Any = {
            bus: SimpleNamespace(ask=lambda node_id, *more, first=2 * bus: self.ask(first + node_id - 1, *more))
            for bus in (0, 1)
        }
        sums = np.zeros((4, 32), "<i4")
        for _ in range(round(seconds / 0.25)):
            self.now_s += 0.25
            sums[2] = self.force
            newest: Any = SimpleNamespace(valid=b"\1" * 4, sums=sums.tobytes())
            self.found.tick(masters, newest, NOBODY, self.now_s)
        return list(self.found.on_bus(1))

    def still(self) -> Counts:
        """Let the board tell for good what it tells now: at neither end."""
        kept = np.clip(self.noise(), 3, MOST - 3)
        self.counts = lambda: kept
        return kept


def test_a_board_with_noise_that_rests_is_frozen_until_it_changes() -> None:
    asked = Asked()
    assert asked.run((NOISY + 3) * PERIOD_S) == []
    asked.still()
    assert asked.run(2 * PERIOD_S + RESTS) == [1]
    assert asked.found.on_bus(0) == {}
    assert np.flatnonzero(asked.found.blocks).tolist() == [2]
    asked.counts = asked.noise
    assert asked.run(PERIOD_S) == []
    assert not asked.found.blocks.any()
    assert asked.lines == [
        "bus1 node 1 is frozen: values stand still while frames go on [node-frozen]",
        "bus1 node 1 is not frozen any more",
    ]


RANDOM = np.random.default_rng(2)
TOLD: dict[str, Callable[[], Counts | None]] = {
    "the same": lambda: np.full(32, 40),
    "rounded": lambda: RANDOM.integers(40, 42, 32),  # a force between two counts
    "zero": lambda: np.zeros(32, np.int64),
    "most": lambda: np.full(32, MOST),
    "most, and one is stuck": lambda: np.where(np.arange(32) == 4, 40, MOST),
    "nothing": lambda: None,
}


@pytest.mark.parametrize(
    ("before", "after"),
    [
        *((each, "still") for each in ("the same", "rounded", "nothing")),
        *(("noise", each) for each in ("zero", "most", "most, and one is stuck")),
    ],
)
def test_a_board_without_noise_or_at_the_end_of_its_range_or_that_tells_nothing_is_never_frozen(
    before: str, after: str
) -> None:
    asked = Asked()
    asked.counts = TOLD.get(before, asked.noise)
    assert asked.run((NOISY + 3) * PERIOD_S) == []
    if after == "still":
        asked.still()
    else:
        asked.counts = TOLD[after]
    assert asked.run(20 * PERIOD_S) == []
    assert asked.lines == []


def test_counts_that_change_as_the_sums_do_are_no_noise() -> None:
    """A sensor without noise under a touch that moves, and then rests."""
    asked = Asked()

    def felt() -> Counts:
        asked.force = int(asked.random.integers(100, 600))
        return np.full(32, asked.force)

    asked.counts = felt
    asked.run(2 * NOISY * PERIOD_S)
    asked.still()
    assert asked.run(20 * PERIOD_S) == []


@given(st.integers(2, RESTS - 1))
def test_a_board_that_rests_for_a_while_is_not_known_to_have_noise(rests: int) -> None:
    asked = Asked()
    asked.run((NOISY + 3) * PERIOD_S)
    asked.still()
    while asked.found._rests[2] < rests:
        assert asked.run(0.25) == []
    asked.counts = asked.noise
    asked.run(PERIOD_S)
    asked.still()
    assert asked.run(20 * PERIOD_S) == []


def test_boards_are_asked_for_few_counts_in_turn() -> None:
    asked = Asked()
    asked.run(10 * PERIOD_S)
    assert np.diff(asked.asked) == pytest.approx(PERIOD_S)
    assert PLACES <= 8


class Still:
    """No touch."""

    has_noise = False

    def __init__(self, contract: Contract) -> None:
        self._shape = contract.layout.taxels.rows, contract.layout.taxels.columns

    def frame(self, step: int) -> Frame:
        return Frame(np.zeros(self._shape, np.float32), "")


class Live(World):
    """Real boards with noise; the converters of the second stop after `stop_s`."""

    stop_s: ClassVar[float]

    def new_hardware(self) -> Any:
        layout, blocks = self.contract.layout, [node.block for node in self.contract.nodes]
        defects = Defects(stops=parse_stops([f"1:{self.stop_s}"], layout))
        return sending_of(layout).hardware(self.contract, blocks, Still(self.contract), None, defects=defects)

    def _wrong_blocks(self, measurement: Measurement) -> list[int]:
        return []


KINDS = {
    "one sample": (small_contract, 25.0, 0.025),
    "analogue": (lambda: small_contract(taxels={"frontend": "analogue", "adc_bits": 12}), 25.0, 0.025),
    "averages": (lambda: small_contract(sampling={"rate_hz": 1000.0}), 16.0, 0.025),
    "steps": (small_stepped, 12.0, 0.005),
}


@pytest.mark.parametrize("kind", KINDS)
def test_a_frozen_board_is_named_and_left_out_of_measurements(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    contract, stop_s, step_s = KINDS[kind][0](), *KINDS[kind][1:]
    monkeypatch.setattr(frozen_boards, "PERIOD_S", 1.0)
    monkeypatch.setattr(frozen_boards, "AGAIN_S", 0.2)
    monkeypatch.setattr(Live, "stop_s", stop_s, raising=False)
    monkeypatch.setattr(Live, "step_s", step_s)
    world = Live(contract)
    calibration = GatewayCalibration(contract)
    begun_s, told = world.now_s, None
    while not calibration.frozen_on(0):
        assert world.now_s < begun_s + stop_s + 12.0
        for each in world.step():
            told = calibration.apply(each)
            assert not told.usable, world.now_s
            calibration.take(each)
            calibration.work()
        calibration.tick(world.gateway.masters, world.now_s)
    assert world.now_s > begun_s + stop_s
    assert calibration.frozen_on(0) == {2: frozen_boards.FROZEN}
    assert calibration.frozen_on(1) == {}
    told = calibration.apply(world.run(0.5)[-1])
    assert valid(told).all()
    used = np.frombuffer(told.usable, np.uint8) != 0
    assert contract.phi.all_of_blocks(used).tolist() == [True, False, True, True]
