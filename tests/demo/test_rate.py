"""The rate that a machine keeps."""

from pathlib import Path

import msgspec
import pytest

from canskin.errors import InputError
from canskin.messages import GatewayStatus
from canskin.peers import new_peer
from demo.options import DemoOptions
from demo.rate import JUDGED_S, LEAST_RUN_S, SETTLED_S, RateJudge, at_rate
from demo.run import Run, rate_judge
from skin.layout import load_layout
from tests.layouts import STEPPED_SKIN
from tests.messages import gateway_status

LAYOUT = load_layout()


def status(cycles: int, complete: int) -> GatewayStatus:
    return gateway_status(cycles, cycles_complete=complete)


@pytest.mark.parametrize(("complete", "kept"), [(290, True), (251, True), (240, False), (100, False)])
def test_cycles_since_the_start_has_settled_judge_the_rate(complete: int, kept: bool) -> None:
    judge = RateJudge()
    assert judge.keeps(status(50, 0), SETTLED_S / 2)
    assert judge.keeps(status(100, 100), SETTLED_S)
    assert not judge.is_judged
    assert judge.keeps(status(300, complete), JUDGED_S) == kept
    assert judge.is_judged
    assert judge.keeps(status(300, 0), JUDGED_S)  # once
    assert RateJudge(is_given=True).keeps(status(300, 0), JUDGED_S)
    assert SETTLED_S < JUDGED_S < LEAST_RUN_S


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


@pytest.mark.parametrize(
    ("name", "options", "rate_hz", "is_judged"),
    [
        ("default", DemoOptions(), 200.0, True),
        ("default", DemoOptions(), 50.0, True),
        ("default", DemoOptions(), 25.0, False),  # an eighth
        ("default", DemoOptions(sync_rate=80.0), 80.0, False),
        ("default", DemoOptions(seconds=LEAST_RUN_S - 1), 200.0, False),
        ("default", DemoOptions(model=Path("mine.npz")), 200.0, True),
        ("fd", DemoOptions(model=Path("mine.npz")), 100.0, False),  # it knows means of cycles
        ("steps", DemoOptions(), 10.0, False),
    ],
)
def test_a_rate_that_was_given_or_cannot_be_judged_is_kept(
    name: str, options: DemoOptions, rate_hz: float, is_judged: bool
) -> None:
    layout = load_layout(Path(name))
    judge = rate_judge(layout if name == "steps" else at_rate(layout, rate_hz), options, layout.sync.rate_hz / 8)
    assert judge.keeps(status(100, 100), SETTLED_S)
    assert judge.keeps(status(300, 100), JUDGED_S) == (not is_judged)


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
