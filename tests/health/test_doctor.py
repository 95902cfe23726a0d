"""``skin doctor time``: what it measures, and what it says of settings that are not best."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

import health.doctor_command
from canskin.errors import InputError, RunError
from canskin.peers import ORDINARY, REAL_TIME
from health.doctor_command import doctor, settings, wake_ups
from shell.service import StopSignal


@pytest.fixture(autouse=True)
def _ordinary(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave the scheduling of the tests, and their garbage, alone."""
    monkeypatch.setattr(health.doctor_command, "request_real_time", lambda _service: ORDINARY)
    monkeypatch.setattr(StopSignal, "install", lambda self: self)


def test_each_wait_begins_at_its_due_time_and_missed_periods_are_skipped(monkeypatch: pytest.MonkeyPatch) -> None:
    """A clock that the test moves; the third wait ends 2.5 periods late."""
    now_s, late_s = [100.0], iter([0.1, 0.2, 2.5, 0.0, 0.0])
    monkeypatch.setattr(health.doctor_command.time, "monotonic", lambda: now_s[0])

    def wait(*_: object) -> None:
        now_s[0] += _[-1] + next(late_s)  # type: ignore[operator]

    monkeypatch.setattr(health.doctor_command.select, "select", wait)
    np.testing.assert_allclose(wake_ups(1.0, 6.5, StopSignal()), [0.1, 0.2, 2.5, 0.0, 0.0], atol=1e-9)


def test_nothing_fails_but_a_run_without_wake_ups(capsys: pytest.CaptureFixture[str]) -> None:
    doctor("time", layout=Path("recognition"), seconds=0.05, json=True)
    found = json.loads(capsys.readouterr().out)
    assert found["late_p50_us"] <= found["late_p99_us"] <= found["late_max_us"]
    assert found["wake_ups"] >= 2
    with pytest.raises(RunError, match="expected a longer --seconds"):
        doctor("time", seconds=1e-9)
    for seconds in (0.0, float("nan"), 1e9):
        with pytest.raises(InputError, match="--seconds"):
            doctor("time", seconds=seconds)


def test_every_setting_that_is_not_best_has_what_mends_it_and_what_that_gains(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    files = {"current_clocksource": "hpet", "status": "Name:\tpython\nCapEff:\t0000000000800000", "preempt": ""}
    monkeypatch.setattr(health.doctor_command, "_read", lambda path: files.get(Path(path).name, ""))
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1})
    found = {each.name: each for each in settings(ORDINARY)}
    assert all(bool(each.mend) == bool(each.gain) for each in found.values())
    assert "clocksource=tsc" in found["clock source"].mend
    assert found["scheduling"].mend
    assert "CAP_SYS_NICE yes" in found["scheduling"].value
    assert not {each.name: each for each in settings(REAL_TIME)}["scheduling"].mend
    doctor("time", layout=Path("recognition"), seconds=0.05)
    assert "clock source: add clocksource=tsc" in capsys.readouterr().out
