"""The end of a run: its picture, its summary, and an interruption."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import msgspec
import numpy as np
import pytest

from canskin.errors import RunError
from demo.folder import PREFIX
from demo.options import DemoOptions
from demo.run import Run, execute
from demo.score import CycleImages, Score
from demo.supervisor import Supervisor
from shell.service import StopSignal
from skin.layout import load_layout
from tests.processes import Processes, Verb

LAYOUT = load_layout()


def run_with_contact(picture: Path, folder: Path) -> Run:
    options = DemoOptions(view=False, picture=picture)
    run = Run(LAYOUT, options, folder)
    force_n = np.full((64, 64), 0.01, np.float32)
    run.score.snapshot = CycleImages(force_n, force_n, force_n)
    return run


@pytest.mark.heavy
def test_picture_that_cannot_be_written_after_all_is_a_failure(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    report = msgspec.structs.replace(Score(LAYOUT).report(), sensor_adds_noise=True)
    saved = run_with_contact(tmp_path / "here.png", tmp_path).save_picture(report)
    assert saved is not None
    assert saved.picture == str(tmp_path / "here.png")
    assert run_with_contact(tmp_path / "gone" / "x.png", tmp_path).save_picture(report) is None
    assert "cannot write the picture" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("adds_noise", "expected"),
    [
        (True, "51.6 dB, against one raw sample's 26.0 dB, over 7 contact cycles"),
        (False, "51.6 dB, against what was played, which has no noise, over 7 contact cycles"),
    ],
)
def test_summary_compares_with_a_sensor_that_adds_noise(adds_noise: bool, expected: str) -> None:
    figures = {"psnr_image_db": 51.6, "psnr_sensor_db": 26.0, "sensor_adds_noise": adds_noise, "contact_cycles": 7}
    assert dict(msgspec.structs.replace(Score(LAYOUT).report(), **figures).rows())["image"] == expected


def test_run_that_measured_nothing_fails_and_says_why() -> None:
    nothing = Score(LAYOUT).report()
    assert nothing.failure.startswith("no cycle: SYNC never came")
    overloaded = msgspec.structs.replace(nothing, cycles=300, frames_dropped=9000, frames_missing=9000, bus_load=[1.0])
    assert overloaded.failure.startswith("no cycle was complete: nodes gave up 9000 TPDOs")
    assert not msgspec.structs.replace(overloaded, cycles_complete=1).failure
    names = [name for name, _ in overloaded.rows()]
    assert names.index("missing") < names.index("bus load")


@pytest.mark.parametrize(
    ("scheduling", "bus", "expected"),
    [
        ("ordinary", 0.5, "no real-time priority"),
        ("realtime", 1.8, "the chain takes 1.8 of 2 cores"),
        ("realtime", 0.5, ""),
    ],
)
def test_incomplete_cycles_have_a_likely_cause(scheduling: str, bus: float, expected: str) -> None:
    figures = {"cycles": 9, "frames_missing": 1, "cores": 2, "scheduling": scheduling, "cpu_ratio": {"bus": bus}}
    rows = dict(msgspec.structs.replace(Score(LAYOUT).report(), **figures).rows())
    assert expected in rows.get("likely cause", "")
    assert ("likely cause" in rows) == bool(expected)


def test_report_as_json_has_a_picture_only_where_one_was_saved() -> None:
    report = Score(LAYOUT).report()
    assert "picture" not in json.loads(msgspec.json.encode(report))
    saved = msgspec.structs.replace(report, picture="x.png")
    assert json.loads(msgspec.json.encode(saved))["picture"] == "x.png"
    assert list(json.loads(msgspec.json.encode(saved))["latency_ms"]) == ["p50", "p99"]


@pytest.mark.parametrize(
    ("options", "known"),
    [
        (DemoOptions(view=False), ["--stroke", "slide"]),
        (DemoOptions(view=False, model=Path("mine.npz")), ["--model", "mine.npz"]),
        (DemoOptions(view=False, classify=False), None),
    ],
)
def test_a_run_has_the_classifier_that_is_asked_for(
    options: DemoOptions, known: list[str] | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    started: dict[str, tuple[str, ...]] = {}
    monkeypatch.setattr(Supervisor, "start", lambda _self, name, *given, **_: started.update({name: given}))
    monkeypatch.setattr("demo.run.READY_PATIENCE_S", 0.0)
    awaited = "nodes, reconstructor" if known is None else "classifier, nodes, reconstructor"
    with pytest.raises(RunError, match=f"^{awaited} did not become ready"):
        execute([Run(LAYOUT, options, tmp_path)], options, tmp_path, StopSignal())
    assert list(started.get("classifier", ())[-2:]) == (known or [])


def test_of_several_skins_the_page_is_of_all_and_waits_for_their_gateways(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    started: dict[str, tuple[str, ...]] = {}
    monkeypatch.setattr(Supervisor, "start", lambda _self, name, *given, **_: started.update({name: given}))
    both = DemoOptions(layout=[Path("default"), Path("fd")], port=0, picture=Path("run.png"))
    first, second = both.of_skin(0, "skin"), both.of_skin(1, "fd")
    assert (first.layout, first.view, first.picture) == ([Path("default")], True, Path("run-skin.png"))
    assert (second.layout, second.view, second.picture) == ([Path("fd")], False, Path("run-fd.png"))
    run = Run(LAYOUT, first, tmp_path / "skin", is_alone=False)
    run._start_services("tcp/HUB:1")
    assert "viewer" not in {*started, *run._missing().split(", ")}
    monkeypatch.setattr(run, "_missing", str)
    monkeypatch.setattr("demo.run.request_real_time", lambda *_: None)
    next(run._try_rate(StopSignal(), "tcp/HUB:1", [].append))
    assert [*started][-2:] == ["gateway", "viewer"]
    assert started["viewer"][:4] == ("view", "--connect", "tcp/HUB:1", "--port")
    assert run._addresses("tcp/HUB:1")[1] == "to watch: skin monitor --connect tcp/HUB:1 --skin skin"


def test_two_skins_of_one_name_are_refused(skin: Verb) -> None:
    code, _, told = skin("demo", "--layout", "fd", "--layout", "fd")
    assert (code, told) == (2, "skin: --layout: expected skins of different names, got 'skin' 2 times\n")


@pytest.mark.heavy
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_interruption_before_the_first_cycle_has_no_summary(number: signal.Signals, tmp_path: Path) -> None:
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    command = [sys.executable, "-m", "skin", "demo", "--no-view"]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment, cwd=tmp_path
    )
    try:
        Processes(tmp_path).until(lambda: bool(list(tmp_path.glob(f"{PREFIX}*/nodes.log"))), "a process of the run")
        process.send_signal(number)
        out, said = process.communicate(timeout=240)
    finally:
        process.kill()
    assert process.returncode == 130
    assert said.strip().splitlines()[-1] == "demo: interrupted before the first cycle"
    assert not out
    assert not list(tmp_path.iterdir())
