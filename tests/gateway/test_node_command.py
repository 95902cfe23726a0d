"""``skin node check``: its errors and its report."""

import sys

import pytest

from gateway.node_check import NodeReport
from gateway.node_command import _show
from skin.command import main


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["check", "--node", "1"], "expected --bus with one of bus0, bus1, bus2, bus3, got none"),
        (["check", "--node", "1", "--bus", "can7"], "bus3, got 'can7'"),
        (["check", "--node", "33", "--bus", "bus0"], "expected a node-ID from 1 to 32 of bus0, got 33"),
        (["test", "--node", "1"], '"check"'),
    ],
)
@pytest.mark.filterwarnings("ignore:Cyclopts application invoked without tokens")
def test_wrong_input_is_one_line_and_exit_code_2(
    arguments: list[str], said: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["skin", "node", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    shown = capsys.readouterr()
    assert ended.value.code == 2
    assert said in shown.err
    assert len(shown.err.splitlines()) == 1


def test_a_single_channel_is_that_of_the_bus(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["check", "--node", "1", "--bus", "bus2", "-i", "socketcan", "-c", "nothing7"]
    monkeypatch.setattr(sys, "argv", ["skin", "node", *arguments])
    with pytest.raises(SystemExit):
        main()
    assert "nothing7" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("differences", "verdict"), [([], "keeps the contract"), (["a"], "1 difference "), (["a", "b"], "2 differences ")]
)
def test_differences_are_listed_and_counted(
    differences: list[str], verdict: str, capsys: pytest.CaptureFixture[str]
) -> None:
    _show(NodeReport("bus1", 7, differences, ["slow"], objects=9, frames=4, cycles=2, latest_s=0.0031))
    *listed, note, last = capsys.readouterr().out.splitlines()
    assert listed == [f"bus1, node 7: {each}" for each in differences]
    assert note == "bus1, node 7: note: slow"
    assert last.startswith(f"bus1, node 7: {verdict}")
    assert last.endswith("(9 objects, 4 TPDOs of 2 cycles, the last 3.1 ms after SYNC)")
