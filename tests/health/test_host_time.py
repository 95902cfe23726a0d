"""``skin doctor time``: what it measures, and what it says of settings that are not best."""

import importlib
import json
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import health.host_time
from canskin.errors import InputError, RunError
from canskin.peers import ORDINARY, REAL_TIME
from health.host_time import measure, settings, wake_ups
from shell.service import StopSignal
from skin.layout import load_layout

RECOGNITION = load_layout(Path("recognition"))


@pytest.fixture(autouse=True)
def _ordinary(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave the scheduling of the tests, and their garbage, alone."""
    monkeypatch.setattr(health.host_time, "request_real_time", lambda _service: ORDINARY)
    monkeypatch.setattr(StopSignal, "install", lambda self: self)


@pytest.fixture
def late_s(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Move a clock in place of the host's; return how late the coming waits end, to be filled in. Others are exact."""
    now_s, late_s = [100.0], list[float]()
    monkeypatch.setattr(health.host_time.time, "monotonic", lambda: now_s[0])

    def wait(*given: Any) -> None:
        now_s[0] += given[-1] + (late_s.pop(0) if late_s else 0.0)

    monkeypatch.setattr(health.host_time.select, "select", wait)
    return late_s


def test_each_wait_begins_at_its_due_time_and_missed_periods_are_skipped(late_s: list[float]) -> None:
    """The third wait ends 2.5 periods late."""
    late_s += [0.1, 0.2, 2.5, 0.0, 0.0]
    np.testing.assert_allclose(wake_ups(1.0, 6.5, StopSignal()), [0.1, 0.2, 2.5, 0.0, 0.0], atol=1e-9)


def test_nothing_fails_but_a_run_without_wake_ups(late_s: list[float], capsys: pytest.CaptureFixture[str]) -> None:
    """Periods of 2 ms, and waits that end 0.5, 1.5 and 1 ms late."""
    late_s += [0.0005, 0.0015, 0.001]
    measure(RECOGNITION, 0.005, as_json=True)
    found = json.loads(capsys.readouterr().out)
    assert found["wake_ups"] == 3
    assert found["late_p50_us"] == pytest.approx(1000)
    assert found["late_max_us"] == pytest.approx(1500)
    with pytest.raises(RunError, match="expected a longer --seconds"):
        measure(RECOGNITION, 1e-9, as_json=False)
    for seconds in (0.0, float("nan"), 1e9):
        with pytest.raises(InputError, match="--seconds"):
            measure(RECOGNITION, seconds, as_json=False)


def test_another_system_than_linux_gets_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    """Windows has no module resource: the command line is there all the same."""
    monkeypatch.setitem(sys.modules, "resource", None)
    importlib.reload(health.host_time)
    monkeypatch.setattr(sys, "platform", "win32")
    with pytest.raises(InputError, match="expected Linux, got win32"):
        health.host_time.measure(RECOGNITION, 0.005, as_json=False)


@pytest.mark.usefixtures("late_s")
def test_every_setting_that_is_not_best_has_what_mends_it_and_what_that_gains(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    files = {"current_clocksource": "hpet", "status": "Name:\tpython\nCapEff:\t0000000000800000", "preempt": ""}
    monkeypatch.setattr(health.host_time, "_read", lambda path: files.get(Path(path).name, ""))
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    found = {each.name: each for each in settings(ORDINARY)}
    assert all(bool(each.mend) == bool(each.gain) for each in found.values())
    assert "clocksource=tsc" in found["clock source"].mend
    assert found["scheduling"].mend
    assert "CAP_SYS_NICE yes" in found["scheduling"].value
    assert not {each.name: each for each in settings(REAL_TIME)}["scheduling"].mend
    measure(RECOGNITION, 0.05, as_json=False)
    assert "clock source: add clocksource=tsc" in capsys.readouterr().out
