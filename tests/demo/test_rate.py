"""The rate that a machine keeps."""

from pathlib import Path

import msgspec
import pytest

from canskin.errors import InputError
from canskin.messages import GatewayStatus
from canskin.peers import new_peer
from demo.options import DemoOptions
from demo.rate import JUDGED_S, LEAST_RUN_S, SETTLED_S, at_rate, is_kept
from demo.run import Run
from skin.layout import Layout, load_layout
from tests.layouts import STEPPED_SKIN
from tests.messages import gateway_status

LAYOUT = load_layout()


def status(cycles: int, complete: int) -> GatewayStatus:
    return gateway_status(cycles, cycles_complete=complete)


@pytest.mark.parametrize(("complete", "kept"), [(290, True), (251, True), (240, False), (100, False)])
def test_cycles_since_the_start_has_settled_judge_the_rate(complete: int, kept: bool) -> None:
    assert is_kept(status(100, 100), status(300, complete)) == kept
    assert not is_kept(status(100, 100), status(100, 100))


def test_another_rate_keeps_the_samples_of_a_cycle_where_boards_can() -> None:
    slow, fast = at_rate(LAYOUT, 25.0), at_rate(LAYOUT, 500.0)
    assert (slow.sync.rate_hz, slow.sampling.rate_hz, slow.samples_per_sync) == (25.0, 125.0, 5)
    assert (fast.sync.rate_hz, fast.sampling.rate_hz, fast.samples_per_sync) == (500.0, 1000.0, 2)
    once = msgspec.structs.replace(LAYOUT, sampling=msgspec.structs.replace(LAYOUT.sampling, rate_hz=None))
    assert at_rate(once, 25.0).sampling.rate_hz is None


@pytest.mark.parametrize("rate_hz", [0.0, -1.0, 1e6])
def test_impossible_rates_are_refused(rate_hz: float) -> None:
    with pytest.raises(InputError, match="--sync-rate"):
        DemoOptions(sync_rate=rate_hz).check(LAYOUT)
    with pytest.raises(InputError, match="--sync-rate is for"):
        DemoOptions(sync_rate=50.0).check(STEPPED_SKIN)


class Rates:
    """Runs in which all cycles are complete at `most_hz` or less."""

    def __init__(self, most_hz: float, options: DemoOptions, folder: Path, layout: Layout = LAYOUT) -> None:
        self.run, self.most_hz = Run(layout, options, folder), most_hz
        self.tried_hz: list[float] = []

    def execute(self) -> None:
        while True:
            rate_hz = self.run._layout.sync.rate_hz
            self.tried_hz.append(rate_hz)
            assert load_layout(Path(self.run._path)).sync.rate_hz == rate_hz
            if all(self._keeps(rate_hz, tenth / 10) for tenth in range(100)):
                return
            self.run._take_rate(rate_hz / 2)

    def _keeps(self, rate_hz: float, elapsed_s: float) -> bool:
        cycles = round(elapsed_s * rate_hz)
        self.run.score.take_gateway(status(cycles, cycles if rate_hz <= self.most_hz else cycles // 2))
        return self.run._keeps_rate(elapsed_s)


@pytest.mark.parametrize(
    ("most_hz", "options", "tried_hz"),
    [
        (200.0, DemoOptions(view=False), [200.0]),
        (60.0, DemoOptions(view=False), [200.0, 100.0, 50.0]),
        (1.0, DemoOptions(view=False), [200.0, 100.0, 50.0, 25.0]),
        (30.0, DemoOptions(view=False, sync_rate=80.0), [80.0]),
        (30.0, DemoOptions(view=False, seconds=LEAST_RUN_S - 1), [200.0]),
    ],
)
def test_a_run_takes_the_rate_that_the_machine_keeps(
    tmp_path: Path, most_hz: float, options: DemoOptions, tried_hz: list[float]
) -> None:
    rates = Rates(most_hz, options, tmp_path)
    rates.execute()
    assert rates.tried_hz == tried_hz
    assert rates.run.score.gateway is not None
    assert SETTLED_S < JUDGED_S < LEAST_RUN_S


@pytest.mark.parametrize(("name", "tried_hz"), [("default", [200.0, 100.0, 50.0, 25.0]), ("fd", [100.0])])
def test_a_run_keeps_the_rate_of_a_model_for_means_of_cycles(tmp_path: Path, name: str, tried_hz: list[float]) -> None:
    rates = Rates(
        30.0, DemoOptions(layout=Path(name), view=False, model=Path("mine.npz")), tmp_path, load_layout(Path(name))
    )
    rates.execute()
    assert rates.tried_hz == tried_hz


def test_services_of_another_rate_are_not_taken_for_those_that_start(tmp_path: Path) -> None:
    run = Run(LAYOUT, DemoOptions(view=False), tmp_path)
    names = "nodes", "reconstructor", "classifier"
    before, after = ([new_peer(LAYOUT.name, name, "") for name in names] for _ in range(2))
    for peer in before:
        run._note(peer, True)
    assert run._missing() == ""
    run._take_rate(50.0)
    assert run._missing() == "classifier, nodes, reconstructor"
    for peer in after:
        run._note(peer, True)
    for peer in before:  # the fabric tells that late
        run._note(peer, False)
    assert run._missing() == ""
