"""``skin nodes``: which nodes it runs, what touches them, and that it closes what it opened."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from canskin.errors import InputError
from dbc.contract import Contract, NodeContract
from nodes import command
from nodes.sampler import Sampler
from nodes.service import wait_on_sockets
from shell import skin_options
from shell.pulse import Beat
from shell.service import StopSignal
from shell.touch_options import NO_TOUCH_OPTIONS, TouchOptions


class Parts:
    """Stand-ins for links, fabric and service; they keep what they are given."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        parts = self
        self.links: Any = None
        self.fabric: Any = None
        self.service: Any = None
        self.named: dict[str, Any] = {}
        self.closed: list[str] = []

        class Closing:
            def __init__(self, name: str) -> None:
                self.name = name

            def close(self) -> None:
                parts.closed.append(self.name)

        def open_links(*given: Any, **named: Any) -> dict[int, Closing]:
            parts.links = (given, named)
            return {bus: Closing(f"bus{bus}") for bus in given[2]}

        def fabric(*given: Any, **named: Any) -> Closing:
            parts.fabric = (given, named)
            return Closing("fabric")

        class Service:
            def __init__(self, *given: Any, **named: Any) -> None:
                parts.service, parts.named = given, named

            def run(self, stop: StopSignal, _beat: Beat) -> None:
                assert stop is parts.links[1]["stop"]
                raise KeyboardInterrupt

        monkeypatch.setattr(command, "serve_buses", lambda *_: None)
        monkeypatch.setattr(command, "open_links", open_links)
        monkeypatch.setattr(skin_options, "Fabric", fabric)
        monkeypatch.setattr(command, "NodesService", Service)

    def run(self, touch: TouchOptions = NO_TOUCH_OPTIONS, **options: Any) -> Any:
        """Run the command; return the boards that it made."""
        with pytest.raises(KeyboardInterrupt):
            command.nodes(touch=touch, **options)
        return self.service[3]


@pytest.fixture
def parts(monkeypatch: pytest.MonkeyPatch) -> Parts:
    return Parts(monkeypatch)


def test_chosen_nodes_join_their_buses_and_the_fabric(
    parts: Parts, contract: Contract, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    store = tmp_path / "flash" / "memory"
    boards = parts.run(only=["bus1:2", "bus3:1-2"], connect="tcp/far:7", store=store)
    assert isinstance(boards, Sampler)
    assert parts.links[0][2] == {1: {2}, 3: {1, 2}}
    assert parts.links[1]["name"] == "nodes"
    assert parts.fabric[0] == (contract.layout.name, "nodes", "tcp/far:7")
    assert parts.fabric[1]["fingerprint"] == contract.phi.fingerprint
    assert parts.service[2] == {1: {2}, 3: {1, 2}}
    assert parts.named == {"store": store, "unnumbered": False, "firmware": None, "wait": wait_on_sockets}
    assert store.is_dir()
    assert sorted(parts.closed) == ["bus1", "bus3", "fabric"]
    assert capsys.readouterr().err == "nodes: 3 nodes on 2 buses\n"


def test_without_the_fabric_only_the_bus_is_used(parts: Parts, capsys: pytest.CaptureFixture[str]) -> None:
    parts.run(only=["bus0:7"], fabric=False)
    assert parts.fabric is None
    assert parts.service[4] is None
    assert parts.closed == ["bus0"]
    assert capsys.readouterr().err == "nodes: 1 node on 1 bus\n"


def test_simulated_touch_gets_noise_and_a_recording_none(parts: Parts, tmp_path: Path) -> None:
    np.save(tmp_path / "still.npy", np.full((4, 64, 64), 0.5))
    still = parts.run(TouchOptions(input=tmp_path / "still.npy", full_scale=1.0), only=["bus0:1"], noise_n=0.001)
    sums = [still.sample(counter, counter).copy() for counter in (1, 2, 3)]
    assert sums[0].any()
    np.testing.assert_array_equal(sums[1], sums[2])
    touched = parts.run(TouchOptions(["golf-ball"]), only=["bus0:1"], noise_n=0.001)
    assert not np.array_equal(*(touched.sample(counter, counter).copy() for counter in (1, 2)))
    calm = parts.run(TouchOptions(["golf-ball, cup"]), only=["bus0:1"], noise_n=0.0)
    assert not calm.sample(1, 1).any()  # the first touch has not begun


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"touch": TouchOptions(seed=-1)}, "--seed: expected 0 or more, got -1"),
        ({"noise_n": -0.1}, "--noise-n: expected 0 or more, got -0.1"),
        ({"noise_n": float("inf")}, "--noise-n: expected 0 or more, got inf"),
        ({"touch": TouchOptions(rate=50.0)}, "--rate is for a recording"),
        ({"touch": TouchOptions(input=Path("mat.npz")), "rest": 1.0}, "--rest is for objects"),
        (
            {"touch": TouchOptions(input=Path("mat.npz"), stroke="press")},
            "--objects and --stroke are for the simulator",
        ),
        ({"touch": TouchOptions(defect=["mismatch=0.1"])}, "mismatch"),  # of boards that make sums in hardware
        ({"store": Path("/proc/none")}, "--store /proc/none: expected a folder that can be written"),
    ],
)
def test_bad_options_are_one_clear_error(options: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        command.nodes(**options)


@pytest.mark.parametrize(
    ("layout", "shape"),
    [("default", (5, 4096)), ("analogue", (1, 1024))],  # samples in a period
)
def test_boards_in_c_are_those_of_the_chosen_nodes_and_get_what_converters_read(
    layout: str, shape: tuple[int, int], parts: Parts, monkeypatch: pytest.MonkeyPatch
) -> None:
    compiled: list[tuple[Contract, list[tuple[int, int]]]] = []

    def firmware(contract: Contract, nodes: list[NodeContract], *, store: Path | None, unnumbered: bool) -> str:
        assert (store, unnumbered) == (None, True)
        compiled.append((contract, [(node.bus, node.node_id) for node in nodes]))
        return "compiled"

    monkeypatch.setattr(command, "Firmware", firmware)
    options = {
        "layout": Path(layout),
        "only": ["bus0:1-2", "bus0:4"],
        "firmware": True,
        "unnumbered": True,
        "noise_n": 0.0,
    }
    boards = parts.run(TouchOptions(["cup"]), **options)
    assert compiled == [(parts.service[0], [(0, 1), (0, 2), (0, 4)])]
    assert parts.named == {"store": None, "unnumbered": True, "firmware": "compiled", "wait": wait_on_sockets}
    assert boards.sample(1, 0).shape == shape


def test_a_recording_is_played_as_its_options_say(parts: Parts, tmp_path: Path) -> None:
    played = np.zeros((5, 64, 64))
    played[1:] = np.arange(1, 5)[:, None, None]
    np.savez(tmp_path / "two.npz", other=np.zeros((5, 64, 64)), mine=played)
    touch = TouchOptions(input=tmp_path / "two.npz", array=["mine"], full_scale=8.0)
    each_cycle = parts.run(touch, only=["bus0:1"])
    # A step of the recording is an eighth of the largest force, 0.02 N.
    forces_n = []
    for counter in (1, 2, 3):
        each_cycle.sample(counter, counter * 10**7)
        truth = each_cycle.take_truth()
        forces_n.append(float(np.frombuffer(truth.true, "<f4").max()))
    assert forces_n == pytest.approx([0.0, 0.0025, 0.005])
    slow = parts.run(replace(touch, rate=100.0), only=["bus0:1"])  # frames of 10 ms, cycles of 5 ms
    for counter in (1, 2, 3):
        slow.sample(counter, counter * 10**7)
        truth = slow.take_truth()
    assert float(np.frombuffer(truth.true, "<f4").max()) == pytest.approx(0.0025)


def test_defects_and_seed_reach_the_taxels(parts: Parts) -> None:
    np_sums = [
        parts.run(TouchOptions(["cup"], seed=seed, **options), only=["bus0:1"]).sample(1, 0)
        for seed, options in (
            (1, {}),
            (1, {}),
            (2, {}),
            (1, {"defect": ["saturated=1"]}),
            (1, {"drift": ["half:step:0.005", "whole:step:0.001"]}),
        )
    ]
    np.testing.assert_array_equal(np_sums[0], np_sums[1])
    assert not np.array_equal(np_sums[0], np_sums[2])
    assert np_sums[3].max() == 32 * 1023
    assert not np.array_equal(np_sums[0], np_sums[4])
