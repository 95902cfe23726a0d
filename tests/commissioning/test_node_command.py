"""``skin node``: its errors, its report, and how it leads a talk."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from canskin.errors import InputError, RunError
from commissioning import talk
from commissioning.node_check_command import show
from commissioning.node_frames import NodeReport
from commissioning.node_options import NodeOptions, lead
from tests.processes import Verb


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["check", "--node", "1"], "expected --bus with one of bus0, bus1, bus2, bus3, got none"),
        (["check", "--node", "1", "--bus", "can7"], "bus3, got 'can7'"),
        (["check", "--node", "33", "--bus", "bus0"], "expected a node-ID of bus0, 1-32, got 33"),
        (["test", "--node", "1"], "test"),
        (["get", "1018h", "--node", "1", "--live", "3"], "--live"),
        (["check", "--node", "1", "--out", "a.csv"], "expected --path and --out with --live alone"),
        (["check", "--bus", "bus0", "--live", "3"], "got both"),
        (["check", "--bus", "bus0"], "expected --node with the node-ID of a board, or --live"),
        (["get", "--bus", "bus0", "--node", "1"], "expected 'skin node get' with objects"),
        (["get", "1018h", "--bus", "bus0"], "expected --node with a node-ID from 1 to 127, got none"),
        (["reset", "--bus", "bus0", "--node", "128"], "node-ID from 1 to 127, got 128"),
        (["update", "a.bin", "--bus", "bus0"], "with --node for one board, or with --all"),
        (["update", "a.bin", "--all", "--bus", "bus0", "--node", "3"], "with --node for one board, or with --all"),
        (["update", "nothing.bin", "--all"], "nothing.bin: cannot read the program"),
    ],
)
def test_wrong_input_is_one_line_and_exit_code_2(arguments: list[str], said: str, skin: Verb) -> None:
    code, _, told = skin("node", *arguments)
    assert code == 2
    assert said in told
    assert len(told.splitlines()) == 1


def test_objects_are_listed_without_a_node(skin: Verb) -> None:
    code, out, _ = skin("node", "objects", "heartbeat")
    assert code == 0
    assert "1017h:0" in out


@pytest.mark.parametrize(
    ("arguments", "channel"),
    [
        (["check", "--node", "1", "--bus", "bus2"], "nothing9"),
        (["get", "1018h", "--node", "1", "--bus", "bus2"], "nothing9"),
        (["get", "1000h", "--node", "1", "--eds", "drive.eds"], "nothing7"),
    ],
)
def test_a_bus_has_the_channel_that_the_gateway_gives_it(
    arguments: list[str], channel: str, skin: Verb, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    lines = (
        "[DeviceInfo] [MandatoryObjects] SupportedObjects=1 1=0x1000 [1000] ParameterName=Type ObjectType=7 DataType=7"
    )
    Path("drive.eds").write_text(f"{lines} AccessType=ro".replace(" ", "\n"))
    assert channel in skin("node", *arguments, "-i", "socketcan", "-c", "nothing7")[2]


@pytest.mark.parametrize(
    ("differences", "verdict"), [([], "keeps the contract"), (["a"], "1 difference "), (["a", "b"], "2 differences ")]
)
def test_differences_are_listed_and_counted(
    differences: list[str], verdict: str, capsys: pytest.CaptureFixture[str]
) -> None:
    show(NodeReport("bus1", 7, differences, ["slow"], objects=9, frames=4, cycles=2, latest_s=0.0031))
    *listed, note, last = capsys.readouterr().out.splitlines()
    assert listed == [f"bus1, node 7: {each}" for each in differences]
    assert note == "bus1, node 7: note: slow"
    assert last.startswith(f"bus1, node 7: {verdict}")
    assert last.endswith("(9 objects, 4 TPDOs of 2 cycles, the last 3.1 ms after SYNC)")


def test_milliseconds_are_told_of_tpdos_alone(capsys: pytest.CaptureFixture[str]) -> None:
    show(NodeReport("bus1", 7, objects=9, frames=1, cycles=2, latest_s=0.25))
    assert capsys.readouterr().out.endswith("(9 objects, 1 TPDOs of 2 cycles, the last 250.0 ms after SYNC)\n")
    show(NodeReport("bus1", 7, objects=9))
    assert capsys.readouterr().out == "bus1, node 7: keeps the contract (9 objects, 0 TPDOs)\n"


def buses(*names: str) -> Any:
    return SimpleNamespace(bus=[SimpleNamespace(name=name) for name in names])


def test_the_only_bus_needs_no_name() -> None:
    assert NodeOptions(bus=None).bus_number(buses("palm")) == 0
    assert NodeOptions(bus="palm").bus_number(buses("palm")) == 0
    assert NodeOptions(bus="c").bus_number(buses("a", "b", "c")) == 2
    with pytest.raises(InputError, match="expected --bus with one of palm, got 'a'"):
        NodeOptions(bus="a").bus_number(buses("palm"))
    with pytest.raises(InputError, match="expected --bus with one of a, b, got none"):
        NodeOptions(bus=None).bus_number(buses("a", "b"))


class Check:
    """A check that is done after so many turns."""

    def __init__(self, turns: int, due_s: float) -> None:
        self.turns, self.due_s = turns, due_s
        self.told: list[str] = []

    @property
    def done(self) -> bool:
        return self.turns == 0

    def take(self, arrived: object, now_s: float) -> None:
        self.told.append(f"take {arrived} at {now_s:g}")

    def tick(self, now_s: float) -> None:
        self.turns -= 1
        self.told.append(f"tick at {now_s:g}")

    def give_up(self, now_s: float) -> None:
        self.told.append(f"give up at {now_s:g}")


@pytest.mark.parametrize(("due_s", "timeout_s"), [(49.0, 0.0), (50.0, 0.0), (50.00390625, 0.00390625), (51.0, 0.01)])
def test_a_check_gets_the_frames_that_come_until_it_is_done(
    monkeypatch: pytest.MonkeyPatch, due_s: float, timeout_s: float
) -> None:
    """A turn waits 10 ms at most, and not for what is due already."""
    waited_s: list[float] = []
    monkeypatch.setattr(talk, "select", SimpleNamespace(select=lambda *given: waited_s.append(given[3])))
    monkeypatch.setattr(talk, "time", SimpleNamespace(monotonic=lambda: 50.0))
    check, link = Check(2, due_s), SimpleNamespace(receive=lambda: "frames")
    lead(check, link, SimpleNamespace(is_set=lambda: False))  # type: ignore[arg-type]
    assert check.told == ["take frames at 50", "tick at 50"] * 2
    assert waited_s == [timeout_s] * 2


def test_a_check_that_is_stopped_goes_on_until_it_is_done(monkeypatch: pytest.MonkeyPatch) -> None:
    """The check is told once, and has the time that it needs to put back what it wrote."""
    monkeypatch.setattr(talk, "select", SimpleNamespace(select=lambda *_: None))
    monkeypatch.setattr("time.monotonic", lambda: 50.0)
    check, link = Check(2, 0.0), SimpleNamespace(receive=lambda: "frames")
    with pytest.raises(RunError, match="stopped before the talk with the node was over"):
        lead(check, link, SimpleNamespace(is_set=lambda: True))  # type: ignore[arg-type]
    assert check.told == ["give up at 50", *["take frames at 50", "tick at 50"] * 2]
